"""Each part of a trajectory's score by itself, against values worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from anchorflow_models.goalflow.config import GoalFlowConfig, ScoreWeights
from anchorflow_models.goalflow.goals import WayScores
from anchorflow_models.goalflow.kinematics import roll_out
from anchorflow_models.goalflow.trajectory_score import (
    HALF,
    SHARP,
    Surroundings,
    _speeds,
    judge,
    trajectory_scores,
)

T, DT = 8, 0.5
SURE = 1 / (1 + math.exp(-HALF / SHARP))  # that a free place is free; a soft score has no 1


def driven(speed: float, *, pull: list[float] | float = 0.0, yaw_rate: float = 0.0) -> Tensor:
    """Poses [1, 1, T, 3] of a car that pulls by m/s² and turns by rad/s."""
    acceleration = torch.as_tensor(pull).expand(T)[None, None]
    curvature = torch.full((1, 1, T), yaw_rate / speed if speed else 0.0)
    return roll_out(torch.tensor([[speed]]), acceleration, curvature, dt=DT)


def nobody() -> Tensor:
    """[1, 1 + K, H, W] of a raster of cells of 0.5 m, row 0 at 80 m, column 0 32 m to the left."""
    return torch.zeros(1, 10, 192, 128)


def score(
    part: str,
    poses: Tensor,
    speed: float,
    *,
    occupied: Tensor | None = None,
    missed: float = 0.0,
) -> float:
    """Score poses on a road without an edge, with only that part of the mean."""
    weights = replace(ScoreWeights(), progress=0.0, time_to_collision=0.0, comfort=0.0)
    around = Surroundings(
        drivable=torch.ones(1, 192, 128, 1),
        occupied=nobody() if occupied is None else occupied,
        speed=torch.tensor([speed]),
        acceleration=torch.zeros(1),
        curvature=torch.zeros(1),
        size=torch.tensor([[4.6, 1.9]]),
    )
    certain = torch.full((1, 1), 100.0)
    config = GoalFlowConfig(score=replace(weights, **{part: 1.0}))
    rules = judge(poses, around, config).rules
    ways = WayScores(certain, certain, certain)
    worth = trajectory_scores(rules, torch.tensor([[missed]]), ways, config)
    return float(worth) / SURE**2  # on the road, and no box touched


@pytest.mark.parametrize(
    ("speed", "drive"),
    [
        (10.0, {"pull": 2.6}),
        (25.0, {"pull": -5.0}),
        (10.0, {"pull": [2.0] * 4 + [-3.0] * 4}),  # 5 m/s³, both within their bounds
        (10.0, {"yaw_rate": 0.6}),  # 6 m/s² to the left
        (3.0, {"yaw_rate": -1.0}),
    ],
    ids=["pulling", "braking", "jerk", "lateral", "yaw_rate"],
)
def test_a_drive_beyond_one_bound_is_no_comfort(speed: float, drive: dict[str, Any]) -> None:
    assert score("comfort", driven(speed, **drive), speed) < 0.2


@pytest.mark.parametrize(
    ("speed", "drive"),
    [
        (10.0, {}),
        (10.0, {"pull": 2.0}),
        (25.0, {"pull": -3.0}),
        (10.0, {"pull": [1.0] * 4 + [-2.0] * 4}),
        (10.0, {"yaw_rate": 0.3}),
        (3.0, {"yaw_rate": -0.7}),
    ],
    ids=["steady", "pulling", "braking", "jerk", "lateral", "yaw_rate"],
)
def test_a_drive_within_all_bounds_is_comfort(speed: float, drive: dict[str, Any]) -> None:
    assert score("comfort", driven(speed, **drive), speed) > 0.9


def test_comfort_counts_from_the_speed_of_now() -> None:
    assert score("comfort", driven(10.0), 13.0) < 0.1  # 6 m/s² in the first half second


@pytest.mark.parametrize(
    ("metres", "layers", "free"),
    [
        (46.0, slice(None), False),  # the front reaches 43.6 m, and half a second later 48.6 m
        (60.0, slice(None), True),
        (46.0, slice(8), True),  # gone when the ego would be there
    ],
)
def test_time_to_collision_is_lost_to_who_is_close_ahead_then(
    metres: float, layers: slice, free: bool
) -> None:
    occupied, row = nobody(), int((80 - metres) / 0.5)
    occupied[:, layers, row - 6 : row, 60:68] = 1.0

    told = score("time_to_collision", driven(10.0), 10.0, occupied=occupied)
    assert told == pytest.approx(SURE if free else 1 - SURE, rel=1e-3)
    # Nobody is touched at the poses themselves.
    assert score("comfort", driven(10.0), 10.0, occupied=occupied) > 0.9


@pytest.mark.parametrize(("metres", "free"), [(11.0, False), (16.0, True)])
def test_who_brakes_comes_to_a_halt_farther_on_than_planned(metres: float, free: bool) -> None:
    """From 8 m/s it plans to stand after 6.4 m, with its front at 10 m."""
    occupied, row = nobody(), int((80 - metres) / 0.5)
    occupied[:, :, row - 6 : row, 60:68] = 1.0
    worth = score("comfort", driven(8.0, pull=-5.0), 8.0, occupied=occupied)
    unhurried = score("comfort", driven(8.0, pull=-5.0), 8.0)
    assert worth == pytest.approx(unhurried if free else 0.0, abs=0.02 * unhurried)


def on_road(poses: Tensor, curvature: float) -> float:
    """Return a start at 5 m/s in a bend of that curvature; the road ends 3 m to the right."""
    drivable = torch.ones(1, 192, 128, 1)
    drivable[:, :, 70:] = 0.0
    around = Surroundings(
        drivable=drivable,
        occupied=nobody(),
        speed=torch.tensor([5.0]),
        acceleration=torch.zeros(1),
        curvature=torch.tensor([curvature]),
        size=torch.tensor([[4.6, 1.9]]),
    )
    config = GoalFlowConfig()
    return float(judge(poses, around, config).rules.on_road)


def test_who_is_steering_to_the_right_goes_on_doing_so() -> None:
    assert on_road(driven(5.0), 0.0) > 0.9
    assert on_road(driven(5.0), 0.2) > 0.9
    assert on_road(driven(5.0), -0.2) < 0.1


@pytest.mark.parametrize(
    ("speed", "way", "share"),
    [
        (0.0, 0.0, 0.0),
        (0.0, 6.0, 6 / 12),  # 4 s at 1.5 m/s²
        (10.0, 40.0, 40 / (40 + 5 * (4 - 5 / 3))),  # 5 m/s more after 10/3 s
        (20.0, 40.0, 40 / 80),
        (10.0, 80.0, 1.0),
    ],
)
def test_progress_is_the_share_of_the_way_that_a_clear_road_allows(
    speed: float, way: float, share: float
) -> None:
    told = score("progress", driven(way / (T * DT)), speed)
    assert told == pytest.approx(share, abs=1e-3)


@pytest.mark.parametrize(("missed", "share"), [(0.0, 1.0), (4.0, math.exp(-0.5))])
def test_a_missed_goal_costs_by_its_distance(missed: float, share: float) -> None:
    free = score("progress", driven(20.0), 10.0, missed=missed)
    assert free == pytest.approx(share, rel=1e-3)


def test_speeds_are_those_at_the_poses() -> None:
    speeds = _speeds(driven(5.0, pull=2.0), dt=DT)[0, 0]
    torch.testing.assert_close(speeds, 5.0 + 2.0 * DT * torch.arange(1.0, T + 1))
