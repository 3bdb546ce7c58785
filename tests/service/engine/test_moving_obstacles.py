"""Anchors among obstacles that move, as a caller meets them: with the student, in process."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from asked_engine import plan
from crowd_judge import Crowd, answered_gap

from anchorflow_client.contract import AnchorBatch, AnchorRequest, resolve_for_card
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine

CELLS, RESOLUTION, RADIUS = 96, 0.1, 0.25
START, GOAL = np.array([-4.0, 0.2]), np.array([4.0, -0.2])
END_ROOM = 0.15  # m that an anchor's end leaves to what stands there
ROUNDING = 1e-4  # m, of answered float32 states


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine(load_bundle(DEFAULT_BUNDLE.parent / "student"), threads=2)


def asked(engine: Engine, obstacles: dict[str, Any] | None = None, **changes: Any) -> AnchorBatch:
    """Plan on a map of 9.6 m with two posts beside the way."""
    occupancy = np.zeros((1, CELLS, CELLS), np.float32)
    occupancy[0, 20:24, 40:44] = occupancy[0, 70:74, 60:64] = 1.0
    request = {
        "cost_map": {"data": occupancy, "resolution": RESOLUTION},
        "x_curr": [*START, 0.5, 0.0, 0.0, 0.0],
        "x_goal": [*GOAL, 0.0, 0.0],
        "robot_radius": RADIUS,
        "seed": 7,
        "obstacles": obstacles,
    }
    return plan(engine, AnchorRequest.build(**(request | changes)))


def moving(*discs: tuple[float, float, float, float], radius: float = 0.3) -> dict[str, Any]:
    """Return discs, each from x and y [m] at velocities by x and y [m/s]."""
    table = np.array(discs, float)
    return {"position": table[:, :2], "velocity": table[:, 2:], "radius": [radius] * len(table)}


def gaps(anchors: AnchorBatch, obstacles: dict[str, Any]) -> np.ndarray:
    """[N] m that each anchor keeps from what moves, by its answered states."""
    crowd, step = Crowd.of(**obstacles), 5e-3  # in which 3 m/s² bend a path by 1e-5 m
    durations = np.broadcast_to(anchors.durations, anchors.safe.shape)
    states = zip(anchors.trajectories, anchors.velocities, durations, strict=True)
    return np.array([answered_gap(crowd, p, v, float(d), step) for p, v, d in states]) - RADIUS


def assert_kept(anchors: AnchorBatch, obstacles: dict[str, Any]) -> None:
    """What is called safe keeps its distance, and the clearance told is none too much."""
    assert anchors.is_finite
    found = gaps(anchors, obstacles)
    assert found[anchors.safe].min(initial=np.inf) >= -ROUNDING
    assert (anchors.clearance[anchors.safe] <= found[anchors.safe] + 0.002).all()


CROSSING = moving((0.0, -2.5, 0.0, 1.0))
SITUATIONS = {
    "one who crosses": CROSSING,
    "one who comes": moving((3.5, 0.0, -1.0, 0.0)),
    "two who cross from both sides": moving((-1.0, -2.5, 0.0, 1.0), (1.5, 3.0, 0.0, -1.0)),
    "one who stands on the way": moving((0.0, 0.1, 0.0, 0.0)),
    "one who turns": {
        "position": [[1.0, -2.5]],
        "forecast": [[[1.0, -1.5], [1.0, -0.5], [0.0, -0.1], [-1.0, -0.1]]],
        "forecast_dt": 0.9,
        "radius": [0.3],
        "growth": 0.05,
    },
}


@pytest.mark.parametrize("horizon_s", [None, 6.0])
@pytest.mark.parametrize("who", SITUATIONS)
def test_anchors_pass_in_more_than_one_way_and_keep_their_distance(
    engine: Engine, who: str, horizon_s: float | None
) -> None:
    anchors = asked(engine, SITUATIONS[who], horizon_s=horizon_s)
    assert anchors.safe.mean() > 0.5
    assert len(np.unique(anchors.arrays["routes"][anchors.safe])) >= 2
    assert_kept(anchors, SITUATIONS[who])
    # None of them would have passed by chance: whoever does not look, collides.
    blind = asked(engine, horizon_s=horizon_s)
    assert (gaps(blind, SITUATIONS[who]) < 0.0).any()
    np.testing.assert_allclose(anchors.trajectories[:, -1], [GOAL] * 64, atol=1e-3)


def test_no_network_draws_anchors_among_what_moves(engine: Engine) -> None:
    other = {"method": "midpoint", "schedule": [0.0, 0.5, 1.0]}
    assert not np.array_equal(asked(engine).trajectories, asked(engine, sampler=other).trajectories)
    anchors = asked(engine, CROSSING)
    assert np.array_equal(anchors.trajectories, asked(engine, CROSSING, sampler=other).trajectories)
    # A warm start at the loneliest draws the anchors of its way, and leaves the others. Projected
    # they come together by themselves.
    sampled: dict[str, Any] = {"refine": {"project": False}}
    anchors = asked(engine, CROSSING, **sampled)
    apart = np.abs(anchors.trajectories[:, None] - anchors.trajectories).max((2, 3))
    fifth = np.sort(apart)[:, 4]
    kept = anchors.trajectories[fifth.argmax()]
    warm = asked(engine, CROSSING, **sampled, warm_start={"trajectory": kept, "tau": 0.95})
    after = np.abs(warm.trajectories - kept).max((1, 2))
    assert np.sort(after)[4] < 0.1 < fifth.max() / 2
    assert after.max() > 1.0
    asks = AnchorRequest.build(
        cost_map={"data": np.zeros((1, 16, 16), np.float32), "resolution": 1.0},
        x_curr=[*START, 0, 0, 0, 0], x_goal=[*GOAL, 0, 0], obstacles=CROSSING,
    )  # fmt: skip
    with pytest.raises(InvalidRequest, match="obstacles: expected none"):
        engine.flow_states(resolve_for_card(asks, engine.card))


def test_who_may_take_any_time_goes_on(engine: Engine) -> None:
    """At the price of time of a standing world these eight metres take 6.6 s."""
    quick, calm = (asked(engine, CROSSING, w_style=style) for style in ("balanced", "conservative"))
    assert quick.durations[quick.best] < 5.5 < calm.durations[calm.best]


def test_one_route_number_is_one_side(engine: Engine) -> None:
    """Before one who crosses or behind, told from the answer alone."""
    anchors = asked(engine, CROSSING)
    routes, behind = anchors.arrays["routes"], []
    for path, lasting in zip(anchors.trajectories, anchors.durations, strict=True):
        at = np.argmax(path[:, 0] > 0.0)
        behind.append(bool(-2.5 + lasting * at / 63 > path[at, 1]))
    sides = {number: {behind[n] for n in np.flatnonzero(routes == number)} for number in routes}
    assert all(len(side) == 1 for side in sides.values())
    assert {side for both in sides.values() for side in both} == {True, False}
    best = [anchors.scores[routes == number].max() for number in sorted(sides)]
    assert best == sorted(best, reverse=True)


@pytest.mark.parametrize(
    "nobody",
    [{}, {"position": [], "velocity": [], "radius": []}, moving((40.0, 40.0, 1.0, 1.0))],
    ids=["no arrays", "empty arrays", "one out of sight"],
)
def test_nobody_in_sight_is_fine(engine: Engine, nobody: dict[str, Any]) -> None:
    anchors = asked(engine, nobody)
    assert anchors.is_finite
    assert anchors.safe.mean() > 0.8
    np.testing.assert_allclose(anchors.trajectories[:, -1], [GOAL] * 64, atol=1e-3)


def test_one_who_stands_is_passed_as_a_post_is(engine: Engine) -> None:
    standing = moving((0.0, 0.1, 0.0, 0.0))
    anchors = asked(engine, standing)
    painted = np.zeros((1, CELLS, CELLS), np.float32)
    side = (np.arange(CELLS) + 0.5) * RESOLUTION - CELLS * RESOLUTION / 2
    painted[0] = np.hypot(side[None] - 0.0, side[:, None] - 0.1) < 0.3
    post = asked(engine, cost_map={"data": painted, "resolution": RESOLUTION})
    for batch in (anchors, post):
        assert batch.safe.mean() > 0.8
        at = np.abs(batch.trajectories[..., 0]).argmin(1)
        heights = batch.trajectories[np.arange(64), at, 1][batch.safe]
        assert {*np.sign(heights - 0.1)} == {-1.0, 1.0}
        assert np.abs(heights - 0.1).min() > 0.5
        assert np.median(np.abs(heights - 0.1)) < 1.8


@pytest.mark.parametrize(
    ("velocity", "horizon_s"), [((0.0, 0.0), None), ((0.0, 0.0), 9.0), ((0.0, 0.3), 9.0)]
)
def test_anchors_end_beside_one_who_is_at_the_goal(
    engine: Engine, velocity: tuple[float, float], horizon_s: float | None
) -> None:
    """One who stands there all along, and one who walks and is there after 9 s."""
    x, y = GOAL - 9.0 * np.array(velocity)
    taken = moving((x, y, *velocity))
    anchors = asked(engine, taken, horizon_s=horizon_s)
    durations = np.broadcast_to(anchors.durations, anchors.safe.shape)
    there = np.array([Crowd.of(**taken).places(np.array([d]))[0, 0] for d in durations])
    apart = np.linalg.norm(anchors.trajectories[:, -1] - there, axis=-1) - 0.3 - RADIUS
    assert anchors.safe.mean() > 0.5
    assert (apart[anchors.safe] >= END_ROOM - 1e-3).all()
    assert np.linalg.norm(anchors.trajectories[:, -1] - GOAL, axis=-1).max() < 1.0
    assert_kept(anchors, taken)


def test_a_goal_in_a_wall_moves_to_where_the_robot_can_get(engine: Engine) -> None:
    occupancy = np.zeros((1, CELLS, CELLS), np.float32)
    occupancy[0, 40:56, 86:90] = 1.0  # x from 3.8 to 4.2 m
    walled = {"cost_map": {"data": occupancy, "resolution": RESOLUTION}}
    anchors = asked(engine, CROSSING, **walled)
    ends = anchors.trajectories[:, -1]
    assert anchors.safe.mean() > 0.5
    assert (np.linalg.norm(ends - GOAL, axis=-1) < 0.8).all()
    assert_kept(anchors, CROSSING)
    with pytest.raises(InvalidRequest, match="x_goal: expected a cell of occupancy below"):
        asked(engine, **walled)


def crowd_of(rng: np.random.Generator, count: int) -> dict[str, Any]:
    """Return walkers anywhere on the map, none of whom stands on the start."""
    position = rng.uniform(-4.8, 4.8, (4 * count, 2))
    position = position[np.linalg.norm(position - START, axis=-1) > 0.8][:count]
    speed = rng.uniform(0.0, 1.5, len(position)) * (rng.random(len(position)) < 0.8)
    heading = rng.uniform(-np.pi, np.pi, len(position))
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    fields: dict[str, Any] = {"position": position, "radius": rng.uniform(0.15, 0.4, len(position))}
    if rng.random() < 0.5:
        return fields | {"velocity": velocity, "growth": float(rng.choice([0.0, 0.1]))}
    step = float(rng.uniform(0.2, 1.0))
    turning = rng.normal(0.0, 0.3, (len(position), 8, 2)) + velocity[:, None]
    ahead = position[:, None] + np.cumsum(turning * step, axis=1)
    return fields | {"forecast": ahead, "forecast_dt": step}


def in_a_crowd(engine: Engine, seed: int, most: int = 30) -> tuple[AnchorBatch, dict[str, Any]]:
    rng = np.random.default_rng(seed)
    obstacles = crowd_of(rng, int(rng.integers(1, most + 1)))
    horizon_s = None if rng.random() < 0.6 else float(rng.uniform(3.0, 15.0))
    robot: dict[str, Any] = {"v_max": float(rng.uniform(0.8, 2.5)), "horizon_s": horizon_s}
    return asked(engine, obstacles, seed=seed, **robot), obstacles


def stream_of(seed: int) -> dict[str, Any]:
    """Return walkers between start and goal who come towards the robot."""
    rng = np.random.default_rng(seed)
    position = np.stack([rng.uniform(-3.0, 4.5, 14), rng.uniform(-2.0, 2.0, 14)], -1)
    position = position[np.linalg.norm(position - START, axis=-1) > 0.9]
    count = len(position)
    velocity = np.stack([rng.uniform(-1.4, -0.4, count), rng.normal(0.0, 0.3, count)], -1)
    return {"position": position, "velocity": velocity, "radius": [0.25] * count}


def test_where_few_anchors_are_safe_roomier_ways_are_found(engine: Engine) -> None:
    """The few that are safe at first keep 0.26 m on average here."""
    room = []
    for seed in (1, 8, 32):
        stream = stream_of(seed)
        anchors = asked(engine, stream, x_curr=[*START, *[0.0] * 4], horizon_s=7.0, seed=seed)
        assert np.linalg.norm(anchors.trajectories[anchors.best, -1] - GOAL) < 0.01
        assert_kept(anchors, stream)
        room.append(anchors.clearance[anchors.best])
    assert np.mean(room) > 0.3


def test_who_is_met_head_on_keeps_more_than_a_hand_s_breadth(engine: Engine) -> None:
    """Anchors that end at the goal in time keep 0.04 m on average here."""
    least = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        ahead, speed = rng.uniform(2.2, 3.4), rng.uniform(1.4, 1.9)
        person = moving((ahead, rng.uniform(-0.3, 0.3), -rng.uniform(1.0, 1.6), 0.0), radius=0.25)
        anchors = asked(
            engine,
            person,
            cost_map={"data": np.zeros((1, CELLS, CELLS)), "resolution": RESOLUTION},
            x_curr=[0.0, 0.0, speed, 0.0, 0.0, 0.0],
            x_goal=[ahead + 0.4, rng.uniform(-0.8, 0.8), 0.0, 0.0],
            v_max=2.0,
            a_max=2.0,
            horizon_s=(ahead + 0.4) / 1.5,
        )
        assert_kept(anchors, person)
        least.append(gaps(anchors, person)[anchors.best])
    assert np.mean(least) > 0.1


def test_in_crowds_nothing_is_called_safe_wrongly(engine: Engine) -> None:
    safe = []
    for seed in range(6):
        anchors, obstacles = in_a_crowd(engine, seed)
        assert_kept(anchors, obstacles)
        safe.append(anchors.safe.mean())
    assert np.mean(safe) > 0.3


def test_in_the_densest_crowds_everything_is_a_number(engine: Engine) -> None:
    for seed in range(20):
        obstacles = crowd_of(np.random.default_rng(100 + seed), 128)
        assert len(obstacles["position"]) == 128
        anchors = asked(engine, obstacles, num_samples=16)
        assert anchors.is_finite
        assert np.isfinite(anchors.arrays["clearance"]).all()
