"""Routes of an answer, the choice between them, and a robot that gets nowhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from staged_planner import Stage, made_batch

from anchorflow_client import AnchorBatch, CostMap, Obstacles, PlannerConfig
from anchorflow_client.planner.plan import why_unsafe
from anchorflow_client.planner.request import AnchorInUse
from anchorflow_client.planner.routes import Commitment, Progress, Routes, landmarks

STEPS = 33
RESOLUTION = 0.1


def wall_map() -> CostMap:
    """Return a map of 8 m by 8 m round (0, 0) with a block of 1 m in the middle."""
    data = np.zeros((1, 80, 80), np.float32)
    data[0, 35:45, 35:45] = 1.0
    return CostMap.build(data, RESOLUTION)


def bent(sides: Sequence[float]) -> np.ndarray:
    """Return [N, T, 2] from (-3, 0) to (3, 0), bent by `sides` m in the middle."""
    share = np.linspace(0.0, 1.0, STEPS)
    along = np.broadcast_to(6.0 * share - 3.0, (len(sides), STEPS))
    return np.stack([along, np.multiply.outer(sides, np.sin(np.pi * share))], -1)


def batch_of(
    sides: Sequence[float], *, scores: Sequence[float], safe: Sequence[bool] | None = None
) -> AnchorBatch:
    paths = bent(sides).astype(np.float32)
    told = {} if safe is None else {"safe": safe}
    return made_batch(paths, velocities=np.gradient(paths, axis=1) / 0.1, scores=scores, **told)


def test_sides_of_an_obstacle_are_two_routes() -> None:
    batch = batch_of([1.5, -1.5, 2.0, -0.9], scores=[-1, -1, -1, -1])
    of = Routes.among(batch, wall_map()).of
    assert of[0] == of[2] != of[1] == of[3]


def test_every_obstacle_has_a_landmark_and_open_ground_none() -> None:
    data = np.zeros((1, 80, 80), np.float32)
    assert len(landmarks(CostMap.build(data, RESOLUTION))) == 0
    data[0, 10:14, 10:14] = data[0, 60, 20] = 1.0
    np.testing.assert_allclose(
        landmarks(CostMap.build(data, RESOLUTION)), [[-2.95, -2.95], [-1.95, 2.05]], atol=1e-6
    )


def test_a_path_that_begins_and_ends_elsewhere_finds_its_route() -> None:
    routes = Routes.among(batch_of([1.5, -1.5], scores=[-1, -1]), wall_map())
    for side, anchor in ((1.4, 0), (-1.7, 1)):
        path = bent([side])[0, 4:-3] + 0.1
        assert routes.route_of(path, 1.0) == routes.of[anchor]


def test_a_path_far_from_every_route_has_none() -> None:
    data = np.zeros((1, 80, 80), np.float32)
    data[0, 35:45, 35:45] = data[0, 60:64, 38:42] = 1.0
    routes = Routes.among(batch_of([1.2, -1.5], scores=[-1, -1]), CostMap.build(data, RESOLUTION))
    assert routes.route_of(bent([3.5])[0], 1.0) is None


@pytest.mark.parametrize(("gain", "chosen"), [(0.15, 1), (0.02, 0)])
def test_a_robot_stays_on_its_route_until_another_is_better_by_the_margin(
    gain: float, chosen: int
) -> None:
    commitment = Commitment(PlannerConfig(switch_gain=gain))
    batch = batch_of([1.5, -1.5, -1.8], scores=[-9.0, -10.0, -11.0])
    routes = Routes.among(batch, wall_map())
    assert commitment.choose(batch, routes, 0.0) == 0  # none is in use: the best
    commitment.in_use = AnchorInUse(batch, 2, 0.0)

    assert commitment.choose(batch, routes, 0.2) == chosen


WALKER = Obstacles.from_fields({"position": [[0, -2]], "velocity": [[0, 1]], "radius": [0.3]})
"""Crosses the middle of the way after 2 s; a robot of 2 s is there before it, one of 6 s behind."""
BEFORE, BEHIND, SLOWER = np.array([2.0, 6.0, 8.0]) / (STEPS - 1)


def timed(dt: Sequence[float], scores: Sequence[float]) -> AnchorBatch:
    """Return anchors straight along x that differ in their time step alone."""
    return replace(batch_of([0.0] * len(dt), scores=scores), dt=np.array(dt))


def test_before_and_behind_what_moves_are_two_routes() -> None:
    ground = CostMap.build(np.zeros((1, 80, 80)), RESOLUTION)
    batch = timed([BEFORE, BEHIND, SLOWER], [-1, -1, -1])

    of = Routes.among(batch, ground, WALKER).of

    assert of[0] != of[1] == of[2]
    assert len(set(Routes.among(batch, ground).of)) == 1


@pytest.mark.parametrize(("gain", "chosen"), [(0.15, 1), (0.02, 0)])
def test_a_robot_that_waits_keeps_waiting_until_going_first_is_better_by_the_margin(
    gain: float, chosen: int
) -> None:
    commitment = Commitment(PlannerConfig(switch_gain=gain))
    batch = timed([BEFORE, BEHIND], [-9.0, -10.0])
    ground = CostMap.build(np.zeros((1, 80, 80)), RESOLUTION)
    commitment.in_use = AnchorInUse(timed([SLOWER], [-10.0]), 0, 0.0)

    routes = Routes.among(batch, ground, WALKER.later(0.2))

    assert commitment.choose(batch, routes, 0.2) == chosen


def test_a_route_that_is_not_safe_any_more_is_left() -> None:
    commitment = Commitment(PlannerConfig())
    batch = batch_of([1.5, -1.5], scores=[-10.0, -9.0], safe=[True, False])
    commitment.in_use = AnchorInUse(batch, 1, 0.0)

    assert commitment.choose(batch, Routes.among(batch, wall_map()), 0.0) == 0


def test_a_route_that_was_given_up_comes_last() -> None:
    commitment = Commitment(PlannerConfig())
    batch = batch_of([1.5, -1.5], scores=[-5.0, -9.0])
    routes = Routes.among(batch, wall_map())
    commitment.in_use = AnchorInUse(batch, 0, 0.0)
    commitment.give_up()
    assert commitment.choose(batch, routes, 0.1) == 1

    only = batch_of([1.5, 1.6], scores=[-5.0, -9.0])
    assert commitment.choose(only, Routes.among(only, wall_map()), 0.2) == 0
    commitment.reset()
    assert commitment.choose(batch, routes, 0.3) == 0


def test_a_robot_that_stays_in_place_is_stuck_after_a_while() -> None:
    progress, goal = Progress(stuck_s=5.0, stuck_m=0.5), np.array([9.0, 0.0])

    def at(now: float, x: float, *, driving: bool = True) -> bool:
        return progress.is_stuck(now, np.array([x, 0.0]), goal, driving=driving)

    assert not at(0.0, 0.0)
    assert not at(4.9, 0.4)
    assert at(5.0, -0.4)
    progress.restart(5.0)
    assert not at(9.9, 0.0)
    assert at(10.0, 0.0)
    assert not at(10.1, 0.6)  # it moves again
    assert not at(15.0, 0.6)
    assert not at(15.2, 0.6, driving=False)  # without a plan it has to stand
    assert not at(21.0, 8.8)
    assert not at(30.0, 8.8)  # it has arrived


def test_a_slow_robot_that_drives_is_not_stuck() -> None:
    stage = Stage(PlannerConfig(stuck_s=5.0, stuck_m=0.5))
    for speed, is_stuck in ((0.06, False), (0.01, True)):
        stage.planner.reset()
        driven = [
            stage.cycle(x_curr=[speed * 0.1 * k, 0, speed, 0, 0, 0], v_max=0.5) for k in range(55)
        ]
        assert driven[-1].followable
        assert (stage.planner.counts["stuck"] > 0) == is_stuck


def test_a_service_that_gives_no_reason_is_spoken_for() -> None:
    batch = batch_of([1.5, -1.5], scores=[-1, -1], safe=[False, False])
    assert why_unsafe(batch) == "none of 2 anchors is safe"
    assert why_unsafe(replace(batch, reason="a wall")) == "a wall"
    assert why_unsafe(batch_of([1.5], scores=[-1])) is None
