"""Judge anchors of robots with an outline and wheels, in places that are narrow for them.

The rivals are what a user has without a footprint: the disc about the outline, which is safe and
fits through less, and the disc inside of it, which is not safe; and one searched way as it comes,
of plain hybrid A* or of OMPL's RRT, with the same time law and certificate. Run by
`anchorflow bench bodies`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from anchorflow_benchmarks import options
from anchorflow_benchmarks.body_judge import BodyJudge, ahead, driven, sideways
from anchorflow_benchmarks.report import ResultTable, Row, progress, report
from anchorflow_client.contract import AnchorBatch, AnchorRequest, resolve_for_card
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_trajectory.bodies import planner as body_planner
from anchorflow_trajectory.bodies.ways import Stretch, WaySearch

CELLS, RESOLUTION = 160, 0.05
V_MAX, A_MAX, OMEGA_MAX = 1.0, 1.5, 2.0
REACHED, TURNED = 0.1, 0.15  # m and rad from the goal
SLIP = 0.05  # m/s
FORKLIFT = np.array([[-0.45, -0.31], [0.45, -0.31], [0.45, 0.31], [-0.45, 0.31]])
TAIL = np.array([[-0.7, -0.25], [0.2, -0.25], [0.2, 0.25], [-0.7, 0.25]])
CAR = np.array([[-0.25, -0.25], [0.65, -0.25], [0.65, 0.25], [-0.25, 0.25]])
JACKAL = np.array([[-0.254, -0.215], [0.254, -0.215], [0.254, 0.215], [-0.254, 0.215]])
PERSON, CROWD = 0.3, 20  # m, radius; people
DIFFERENTIAL: dict[str, Any] = {"kind": "differential", "omega_max": OMEGA_MAX}
ACKERMANN: dict[str, Any] = {
    "kind": "ackermann",
    "min_turning_radius": 1.0,
    "omega_max": OMEGA_MAX,
}
OMNI: dict[str, Any] = {"kind": "omni", "omega_max": OMEGA_MAX}
Pose = tuple[float, float, float]
Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True)
class Situation:
    """A map about (0, 0), a robot, and the poses between which it drives.

    heading: rad, tolerance at the goal; people: [M, 4], place and velocity of each
    """

    occupied: NDArray[np.bool_]
    start: Pose
    goal: Pose
    footprint: NDArray[np.float64]
    kinematics: Mapping[str, Any]
    heading: float | None = None
    people: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))

    def fields(self, num: int, seed: int) -> dict[str, Any]:
        """Return the request's fields."""
        data = self.occupied[None].astype(np.float32)
        moving = {
            "position": self.people[:, :2],
            "velocity": self.people[:, 2:],
            "radius": np.full(len(self.people), PERSON),
        }
        return {
            "cost_map": {"data": data, "resolution": RESOLUTION},
            "x_curr": [*self.start, *[0.0] * 6],
            "x_goal": [*self.goal, *[0.0] * 3],
            "footprint": self.footprint,
            "kinematics": self.kinematics,
            "goal_tolerance": {"position": REACHED, "heading": self.heading},
            "v_max": V_MAX,
            "a_max": A_MAX,
            "obstacles": moving if len(self.people) else None,
            "num_samples": num,
            "seed": seed,
        }


def painted(value: bool, *rectangles: Rectangle, on: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a copy of cells with rectangles of x and y [m], from and to, set to a value."""
    cells = on.copy()
    for x0, x1, y0, y1 in rectangles:
        low, high, left, right = (
            round(float(each) / RESOLUTION + CELLS / 2) for each in (y0, y1, x0, x1)
        )
        cells[low:high, left:right] = value
    return cells


FREE = np.zeros((CELLS, CELLS), np.bool_)
FULL = ~FREE


def doorway(rng: np.random.Generator) -> Situation:
    """A door of 0.12 to 0.25 m more than the forklift's width, in a wall across the room."""
    y, half = rng.uniform(-1.2, 1.2), 0.31 + rng.uniform(0.06, 0.125)
    cells = painted(True, (-0.15, 0.15, -4, 4), on=FREE)
    cells = painted(False, (-0.15, 0.15, y - half, y + half), on=cells)
    start = (-2.0, rng.uniform(-1, 1), rng.uniform(-0.8, 0.8))
    return Situation(cells, start, (2.0, rng.uniform(-1, 1), 0.0), FORKLIFT, DIFFERENTIAL)


def aisle(rng: np.random.Generator) -> Situation:
    """An aisle narrower than the forklift's diagonal, with a corner at its end."""
    half, side = rng.uniform(0.45, 0.52), rng.choice([-1.0, 1.0])
    low, high = sorted((-side * 0.8, side * 3.0))
    cells = painted(False, (-3.5, 0.6, -half, half), (0.4, 2.2, low, high), on=FULL)
    return Situation(cells, (-2.8, 0, 0), (1.3, side * 2.2, 0), FORKLIFT, DIFFERENTIAL)


def tail(rng: np.random.Generator) -> Situation:
    """Posts about a robot whose outline reaches far behind its axle."""
    x, y = rng.uniform(-2.0, 2.0, (2, 8))
    posts = [(a - 0.1, a + 0.1, b - 0.1, b + 0.1) for a, b in zip(x, y, strict=True)]
    cells = painted(True, *posts, on=FREE)
    cells = painted(False, (-3.9, -2.0, -0.9, 0.9), (2.0, 3.9, -0.9, 0.9), on=cells)
    return Situation(cells, (-2.8, 0, rng.uniform(-0.5, 0.5)), (2.9, 0, 0), TAIL, DIFFERENTIAL)


def parking(rng: np.random.Generator) -> Situation:
    """A gap in a row of parked cars, which is entered backwards."""
    side, gap = rng.choice([-1.0, 1.0]), rng.uniform(1.9, 2.3)
    low, high = sorted((side * 0.35, side * 0.95))
    row = ((-3.5, -1.0 - gap / 2, low, high), (-1.0 + gap / 2, 2.0, low, high))
    low, high = sorted((side * 0.95, side * 1.2))
    cells = painted(True, *row, (-3.5, 2.0, low, high), on=FREE)
    goal = (-1.2, side * 0.65, 0.0)
    start = (rng.uniform(0.0, 0.6), -side * rng.uniform(0.0, 0.3), rng.uniform(-0.1, 0.1))
    drives = ACKERMANN | {"reverse": True}
    return Situation(cells, start, goal, CAR, drives, heading=TURNED)


def slalom(rng: np.random.Generator) -> Situation:
    """Posts about a car that cannot drive backwards."""
    x, y = rng.uniform(-1.8, 2.0, 10), rng.uniform(-2.5, 2.5, 10)
    posts = [(a - 0.12, a + 0.12, b - 0.12, b + 0.12) for a, b in zip(x, y, strict=True)]
    cells = painted(True, *posts, on=FREE)
    cells = painted(False, (-3.9, -1.9, -1.3, 1.3), (2.4, 3.9, -1, 1), on=cells)
    return Situation(cells, (-3.2, 0, rng.uniform(-0.5, 0.5)), (3.1, 0, 0), CAR, ACKERMANN)


def crossing(rng: np.random.Generator) -> Situation:
    """Two people who cross an open place where the robot would meet them."""
    start, goal = (-3.0, rng.uniform(-1, 1), rng.uniform(-0.6, 0.6)), (3.0, rng.uniform(-1, 1), 0)
    people = []
    for share in rng.uniform([0.25, 0.5], [0.5, 0.75]):
        place = (1.0 - share) * np.array(start[:2]) + share * np.array(goal[:2])
        side, speed = rng.uniform(np.pi / 4, 3 * np.pi / 4), rng.uniform(0.4, 1.2)
        velocity = rng.choice([-1.0, 1.0]) * speed * np.array([np.cos(side), np.sin(side)])
        people.append([*(place - velocity * (6.5 * share + rng.uniform(-0.4, 0.4))), *velocity])
    return Situation(FREE, start, goal, JACKAL, DIFFERENTIAL, people=np.array(people))


def oncoming(rng: np.random.Generator) -> Situation:
    """Somebody who walks towards the robot in a corridor that is wide enough for both."""
    half, speed = rng.uniform(0.85, 1.3), rng.uniform(0.4, 1.0)
    cells = painted(False, (-3.9, 3.9, -half, half), on=FULL)
    person = np.array([[rng.uniform(0.0, 2.5), rng.uniform(-0.3, 0.3), -speed, 0.0]])
    start, goal = (-3.0, 0.0, rng.uniform(-0.3, 0.3)), (3.0, 0.0, 0.0)
    return Situation(cells, start, goal, JACKAL, DIFFERENTIAL, people=person)


def sidestep(rng: np.random.Generator) -> Situation:
    """A bay beside a corridor that a robot has to slide into, since it has no room to turn."""
    side, spare, bay = rng.choice([-1.0, 1.0]), rng.uniform(0.1, 0.2), rng.uniform(-0.5, 1.5)
    half, deep = 0.31 + spare, 1.0 + 2.0 * spare
    low, high = sorted((0.0, side * (half + deep)))
    place = (bay - 0.45 - spare, bay + 0.45 + spare, low, high)
    cells = painted(False, (-3.9, 3.9, -half, half), place, on=FULL)
    goal = (bay, side * (half + 0.6), 0.0)
    return Situation(cells, (-2.5, 0.0, 0.0), goal, FORKLIFT, OMNI, heading=TURNED)


def crowd(rng: np.random.Generator) -> Situation:
    """Twenty people who cross an open place in all directions."""
    start, goal = (-3.0, rng.uniform(-1, 1), rng.uniform(-0.6, 0.6)), (3.0, rng.uniform(-1, 1), 0)
    people: list[list[float]] = []
    while len(people) < CROWD:
        x, y = rng.uniform(-3.7, 3.7, 2)
        away, speed = rng.uniform(-np.pi, np.pi), rng.uniform(0.4, 1.2)
        if min(np.hypot(x - start[0], y - start[1]), np.hypot(x - goal[0], y - goal[1])) > 1.2:
            people.append([x, y, speed * np.cos(away), speed * np.sin(away)])
    return Situation(FREE, start, goal, JACKAL, DIFFERENTIAL, people=np.array(people))


FAMILIES: dict[str, Callable[[np.random.Generator], Situation]] = {
    "door": doorway,
    "aisle": aisle,
    "tail": tail,
    "parking": parking,
    "slalom": slalom,
    "crossing": crossing,
    "oncoming": oncoming,
    "sidestep": sidestep,
    "crowd": crowd,
}


def verdicts(found: AnchorBatch, at: Situation) -> NDArray[np.bool_]:
    """Return [N, 3]: touches nothing, ends in its goal, and can be driven within the limits."""
    judge = BodyJudge(at.occupied, RESOLUTION, at.footprint)
    poses, velocities = found.trajectories, found.velocities
    places = np.stack([at.people[:, :2], at.people[:, :2] + at.people[:, 2:]], 1)
    radii = np.full(len(places), PERSON)
    free = [
        not judge.touches(path) and not judge.meets(path, lasts, places, radii)
        for path, lasts in zip(poses, found.durations.tolist(), strict=True)
    ]
    away = np.hypot(*(poses[:, -1, :2] - at.goal[:2]).T) <= REACHED + 1e-3
    away &= np.hypot(*(poses[:, 0, :2] - at.start[:2]).T) <= REACHED
    away &= np.abs(turned(poses[:, 0, 2] - at.start[2])) <= TURNED
    if at.heading is not None:
        away &= np.abs(turned(poses[:, -1, 2] - at.goal[2])) <= at.heading + 1e-3
    pace, spin = ahead(poses, velocities), np.abs(velocities[..., 2])
    speed = np.hypot(velocities[..., 0], velocities[..., 1])
    drives = (speed.max(1) <= 1.05 * V_MAX) & (spin.max(1) <= 1.05 * OMEGA_MAX)
    if at.kinematics["kind"] != "omni":
        drives &= np.abs(sideways(poses, velocities)).max(1) <= SLIP
        drives &= (pace.min(1) >= -SLIP) | at.kinematics.get("reverse", False)
    if radius := at.kinematics.get("min_turning_radius"):
        drives &= (spin <= 1.05 * np.abs(pace) / radius + 0.02).all(1)
    return np.stack([free, away, drives], 1)


def replayed(found: AnchorBatch, at: Situation) -> bool:
    """Return whether the best anchor, if safe, leads a bicycle to the goal by itself."""
    best = found.best
    if not found.safe[best]:
        return False
    lasts = float(found.durations[best])
    end = driven(found.trajectories[best], found.velocities[best], lasts)
    arrives = np.hypot(*(end[:2] - at.goal[:2])) <= REACHED
    return bool(arrives and (at.heading is None or abs(turned(end[2:] - at.goal[2])) <= at.heading))


def turned(angle: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return angles in rad from -pi to pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def as_disc(engine: Engine, at: Situation, radius: float, num: int, seed: int) -> AnchorBatch:
    """Plan for a disc; its poses look along the way."""
    fields = at.fields(num, seed) | {"footprint": None, "kinematics": None}
    fields |= {"x_curr": [*at.start[:2], *[0.0] * 4], "x_goal": [*at.goal[:2], *[0.0] * 2]}
    low, high = engine.card.cost_map.ranges["robot_radius"]
    found = ask(engine, fields | {"robot_radius": float(np.clip(radius, low, high))})
    velocity, pull = found.velocities, found.accelerations
    speed = np.maximum(np.hypot(velocity[..., 0], velocity[..., 1]), 1e-6)
    moves = np.where((speed > SLIP)[..., None], velocity, velocity[:, [len(velocity[0]) // 2]])
    heading = np.unwrap(np.arctan2(moves[..., 1], moves[..., 0]))
    cross = velocity[..., 0] * pull[..., 1] - velocity[..., 1] * pull[..., 0]
    spin = np.where(speed > SLIP, cross / speed**2, 0.0)
    arrays = dict(found.arrays) | {
        "trajectories": np.concatenate([found.trajectories, heading[..., None]], -1),
        "velocities": np.concatenate([velocity, spin[..., None]], -1),
        "accelerations": np.concatenate([pull, 0.0 * spin[..., None]], -1),
    }
    return replace(found, arrays=arrays)


def ask(engine: Engine, fields: Mapping[str, Any]) -> AnchorBatch:
    """Plan in this process."""
    return engine.plan(resolve_for_card(AnchorRequest.build(**fields), engine.card))


class OneWay(WaySearch):
    """The cheapest way only, as other planners return it."""

    def find(self, certified: float) -> Iterator[list[list[Stretch]]]:
        """Yield one way of each search."""
        return (ways[:1] for ways in super().find(certified))


PLAIN = {"SETTLING": 0, "LONG": 0, "WIDE": 0.0, "YIELDS": ((0.0, 1.0),)}


def plainly(
    search: type[WaySearch], engine: Engine, at: Situation, num: int, seed: int
) -> AnchorBatch:
    """Plan along a searched way as it is: no descent, no shapes, no waiting."""
    plain = {"WaySearch": search, **PLAIN}
    own = {name: getattr(body_planner, name) for name in plain}
    try:
        for name, value in plain.items():
            setattr(body_planner, name, value)
        return ask(engine, at.fields(num, seed))
    finally:
        for name, value in own.items():
            setattr(body_planner, name, value)


def by_rrt(engine: Engine, at: Situation, num: int, seed: int) -> AnchorBatch:
    """Plan along the way of OMPL's RRT."""
    from anchorflow_benchmarks.ompl_ways import OmplWays  # OMPL is optional

    return plainly(OmplWays, engine, at, num, seed)


PLANNERS: dict[str, Callable[[Engine, Situation, int, int], AnchorBatch]] = {
    "poses": lambda engine, at, num, seed: ask(engine, at.fields(num, seed)),
    "hybrid A*": partial(plainly, OneWay),
    **({"RRT (OMPL)": by_rrt} if find_spec("ompl") else {}),
    "disc about it": lambda engine, at, num, seed: as_disc(
        engine, at, float(np.hypot(*at.footprint.T).max()), num, seed
    ),
    "disc inside": lambda engine, at, num, seed: as_disc(
        engine, at, float(np.abs(at.footprint).min()), num, seed
    ),
}


def row_of(name: str, engine: Engine, situations: list[Situation], num: int) -> Row:
    """Return a planner's figures.

    any: share of the situations with an anchor called safe that is free, arrives and can be driven
    replayed: of a car, share whose best anchor is safe and drives a bicycle to the goal, open loop
    success, free, arrives, drivable: shares of the anchors
    touching: anchors called safe that are not free; lies: those, and those that cannot be driven
    ms: median of a plan
    """
    shares, touching, lies, spent, open_loop = [], 0, 0, [], []
    for seed, at in enumerate(situations):
        began = time.perf_counter()
        found = PLANNERS[name](engine, at, num, seed)
        spent.append(1e3 * (time.perf_counter() - began))
        kept = verdicts(found, at)
        good = kept.all(1)
        if at.kinematics["kind"] == "ackermann":
            open_loop.append(replayed(found, at))
        touching += int((found.safe & ~kept[:, 0]).sum())
        lies += int((found.safe & ~(kept[:, 0] & kept[:, 2])).sum())
        shares.append([(good & found.safe).any(), good.mean(), *kept.mean(0)])
    names = ("any", "success", "free", "arrives", "drivable")
    figures = dict(zip(names, np.mean(shares, axis=0).tolist(), strict=True))
    counted = {"touching": touching, "lies": lies, "ms": float(np.median(spent))}
    cars = {"replayed": float(np.mean(open_loop))} if open_loop else {}
    return {"planner": name, **figures, **counted, **cars}


def bodies(
    *,
    bundle: options.Bundle = options.STUDENT,
    limit: Annotated[int, typer.Option(min=1, help="Situations of each family.")] = 24,
    seed: Annotated[int, typer.Option(help="Of the first situation.")] = 0,
    num: options.Num = 64,
    threads: options.Threads = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Judge anchors of robots with a footprint and wheels, beside the discs that they are not."""
    engine = Engine(load_bundle(Path(bundle)), threads=threads)
    tables = []
    with progress("judging", len(FAMILIES) * len(PLANNERS)) as advance:
        for family, drawn in FAMILIES.items():
            numbers = range(seed, seed + limit)
            found = [drawn(np.random.default_rng([n, len(family)])) for n in numbers]
            rows = []
            for name in PLANNERS:
                rows.append(row_of(name, engine, found, num))
                advance(1)
            tables.append(ResultTable(family, rows))
    about = {"situations": f"{limit} of each family", "anchors a situation": str(num)}
    report("Bodies", about, tables, out)
