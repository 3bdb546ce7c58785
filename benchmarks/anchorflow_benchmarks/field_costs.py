"""What the fields of a request cost: the same scenes with people, soft ground, or wheels, by turns.

Every call has a map that the engine has not seen, by cells of its edge, but for the row that says
so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import count, cycle, islice
from typing import Any

import numpy as np

from anchorflow_benchmarks.report import Row
from anchorflow_benchmarks.turns import MIN_ROUNDS, p50, p99, take_turns
from anchorflow_client.contract import AnchorRequest, OdeSpec, SamplerChoice, resolve_for_card
from anchorflow_service.engine import Engine
from anchorflow_trajectory.scene import Scene

SEED = 1
PEOPLE, PACE, RADIUS = 20, 1.0, 0.25  # how many, m/s and m
AWAY = 1.0  # m from people to both ends
RECTANGLE = [[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]  # m
WAVES = 3  # soft patches across a map, and as many between them
BITS = 24
AS_IT_IS = "occupancy alone"

Draw = Callable[[Scene, np.random.Generator], dict[str, Any]]


def field_rows(
    engine: Engine,
    scenes: Sequence[Scene],
    *,
    num: int,
    sampler: OdeSpec,
    rounds: int,
    budget_s: float,
    rest_s: float = 0.0,
) -> list[Row]:
    """Return p50 and p99 in ms of requests with each field, and p50 over that without any."""
    turns, asked = count(), 1 + max(rounds, MIN_ROUNDS)
    calls = {
        name: _calls(engine, _requests(scenes, draw, turns, num=num, sampler=sampler), asked)
        for name, draw in FIELDS.items()
    }
    times = take_turns(calls, rounds=rounds, budget_s=budget_s, rest_s=rest_s)
    plain = p50(times[AS_IT_IS])
    return [
        {
            "request": name,
            "N": num,
            "p50 ms": p50(spent),
            "p99 ms": p99(spent),
            "p50 over plain": p50(spent) / plain,
            "p99 over p50": p99(spent) / p50(spent),
            "requests": len(spent),
        }
        for name, spent in times.items()
    ]


def _calls(engine: Engine, requests: Iterator[AnchorRequest], asked: int) -> Callable[[], object]:
    """Return a call that plans the next of `asked` requests, which are made before."""
    ready = iter([resolve_for_card(each, engine.card) for each in islice(requests, asked)])
    return lambda: engine.plan(next(ready))


def _requests(
    scenes: Sequence[Scene], draw: Draw, turns: Iterator[int], *, num: int, sampler: OdeSpec
) -> Iterator[AnchorRequest]:
    """Yield a request for each scene in turn, with the fields that `draw` gives."""
    for index, scene in cycle(enumerate(scenes)):
        rng = np.random.default_rng([SEED, index])
        asked: dict[str, Any] = {
            "cost_map": {
                "data": _unseen(scene, next(turns))[None],
                "resolution": scene.resolution,
                "origin": scene.origin,
            },
            "x_curr": scene.x_curr,
            "x_goal": scene.x_goal,
            "w_style": scene.w_style,
            "num_samples": num,
            "robot_radius": scene.robot_radius,
            "seed": SEED,
            "sampler": SamplerChoice(sampler.method, sampler.schedule),
        }
        fields = draw(scene, rng)
        cost_map = asked["cost_map"] | fields.pop("cost_map", {})
        if (soft := cost_map.pop("risk", None)) is not None:
            layers = [cost_map["data"][0], np.ones_like(soft), soft]
            cost_map["data"] = np.stack(layers).astype(np.float32)
        yield AnchorRequest.build(**asked | {"cost_map": cost_map} | fields)


def _unseen(scene: Scene, turn: int) -> np.ndarray:
    """Return the occupancy [H, W] with cells of the map's edge turned by the bits of a number."""
    cells = scene.cost_map[0].astype(np.float32)
    edge = cells[0, :BITS]
    turned = ((turn + 1) >> np.arange(len(edge))) % 2 == 1
    edge[turned] = 1.0 - edge[turned]
    return cells


def _soft(scene: Scene, rng: np.random.Generator) -> dict[str, Any]:
    height, width = scene.cost_map.shape[1:]
    rows, columns = np.indices((height, width)) * (2 * np.pi * WAVES / max(height, width))
    first, second = rng.uniform(0.0, 2 * np.pi, 2)
    return {"cost_map": {"risk": np.clip(np.sin(rows + first) * np.sin(columns + second), 0, 1)}}


def _people(scene: Scene, rng: np.random.Generator) -> dict[str, Any]:
    size = scene.resolution * np.array(scene.cost_map.shape[:0:-1])
    places = scene.origin + rng.uniform(0.0, 1.0, (20 * PEOPLE, 2)) * size
    ends = np.stack([scene.x_curr[:2], scene.x_goal[:2]])
    far = (np.linalg.norm(places[:, None] - ends, axis=-1) > AWAY).all(1)
    angle = rng.uniform(0.0, 2 * np.pi, PEOPLE)
    return {
        "obstacles": {
            "position": places[far][:PEOPLE],
            "velocity": PACE * np.stack([np.cos(angle), np.sin(angle)], -1),
            "radius": np.full(PEOPLE, RADIUS),
        }
    }


def _wheels(scene: Scene, rng: np.random.Generator) -> dict[str, Any]:  # noqa: ARG001
    way = scene.x_goal[:2] - scene.x_curr[:2]
    heading = float(np.arctan2(way[1], way[0]))
    return {
        "footprint": RECTANGLE,
        "kinematics": {"kind": "differential"},
        "sampler": None,
        "x_curr": [*scene.x_curr[:2], heading, *np.zeros(6)],
        "x_goal": [*scene.x_goal[:2], heading, *np.zeros(3)],
    }


FIELDS: Mapping[str, Draw] = {
    AS_IT_IS: lambda *_: {},
    "the same map again": lambda scene, _: {"cost_map": {"data": np.float32(scene.cost_map[:1])}},
    "soft ground": _soft,
    "20 people": _people,
    "a rectangle on two wheels": _wheels,
}
