"""Each part of a trajectory's score by itself, by the rules and by learnt outcomes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from anchorflow_client.sensors import ROUTE_POINTS
from anchorflow_models.goalflow import GoalFlow
from anchorflow_models.goalflow.config import GoalFlowConfig, ScoreWeights
from anchorflow_models.goalflow.networks import WayScores
from anchorflow_models.goalflow.trajectory_score import (
    HALF,
    LEARNT,
    LOOKS,
    RULES,
    SHARP,
    Rules,
    Surroundings,
    judge,
    met,
    outcome_scores,
    trajectory_scores,
)
from anchorflow_models.goalflow.ways import roll_out

CONFIG = GoalFlowConfig(
    goals=16, picked=5, width=16, channels=8, feature_channels=4, layers=1, outcomes=True
)
CERTAIN = 100.0  # a logit
T, DT = 8, 0.5
SURE = 1 / (1 + math.exp(-HALF / SHARP))  # that a free place is free; a soft score has no 1


def driven(speed: float, *, pull: list[float] | float = 0.0, yaw_rate: float = 0.0) -> Tensor:
    """Poses [1, 1, T, 3] of a car that pulls by m/s² and turns by rad/s."""
    acceleration = torch.as_tensor(pull).expand(T)[None, None]
    curvature = torch.full((1, 1, T), yaw_rate / speed if speed else 0.0)
    return roll_out(torch.tensor([[speed]]), acceleration, curvature, dt=DT)


def around(speed: float, **changes: Any) -> Surroundings:
    """Return an empty plane that is all drivable, of cells of 0.5 m; row 0 lies at 80 m, column 0
    32 m to the left.
    """
    plane = Surroundings(
        drivable=torch.ones(1, 192, 128, 1),
        occupied=torch.zeros(1, 10, 192, 128),
        speed=torch.tensor([speed]),
        acceleration=torch.zeros(1),
        curvature=torch.zeros(1),
        size=torch.tensor([[4.6, 1.9]]),
    )
    return replace(plane, **changes)


def box(metres: float, layers: slice = slice(None)) -> Tensor:
    """Return occupancy of a box whose near end lies so far ahead, at some of the times."""
    occupied, row = torch.zeros(1, 10, 192, 128), int((80 - metres) / 0.5)
    occupied[:, layers, row - 6 : row, 60:68] = 1.0
    return occupied


def score(
    part: str, poses: Tensor, speed: float, *, missed: float = 0.0, **changes: Tensor
) -> float:
    """Score poses on a road without an edge, with only that part of the mean."""
    weights = replace(ScoreWeights(), progress=0.0, time_to_collision=0.0, comfort=0.0)
    certain = torch.full((1, 1), CERTAIN)
    config = GoalFlowConfig(score=replace(weights, **{part: 1.0}))
    rules = judge(poses, around(speed, **changes), config, config.score).rules
    ways = WayScores(certain, certain, certain)
    worth = trajectory_scores(rules, torch.tensor([[missed]]), ways, config.score)
    return float(worth) / SURE**2  # on the road, and no box touched


@pytest.mark.parametrize(
    ("speed", "within", "beyond"),
    [
        (10.0, {}, {"pull": 2.6}),
        (10.0, {"pull": 2.0}, {"pull": 2.6}),
        (25.0, {"pull": -3.0}, {"pull": -5.0}),
        # Jerks of 3 and 5 m/s³, the accelerations within their bounds.
        (10.0, {"pull": [1.0] * 4 + [-2.0] * 4}, {"pull": [2.0] * 4 + [-3.0] * 4}),
        (10.0, {"yaw_rate": 0.3}, {"yaw_rate": 0.6}),  # 6 m/s² to the left
        (3.0, {"yaw_rate": -0.7}, {"yaw_rate": -1.0}),
    ],
    ids=["steady", "pulling", "braking", "jerk", "lateral", "yaw_rate"],
)
def test_comfort_is_lost_beyond_each_bound(
    speed: float, within: dict[str, Any], beyond: dict[str, Any]
) -> None:
    assert score("comfort", driven(speed, **within), speed) > 0.9
    assert score("comfort", driven(speed, **beyond), speed) < 0.2


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
    occupied = box(metres, layers)
    told = score("time_to_collision", driven(10.0), 10.0, occupied=occupied)
    assert told == pytest.approx(SURE if free else 1 - SURE, rel=1e-3)
    # Nobody is touched at the poses themselves.
    assert score("comfort", driven(10.0), 10.0, occupied=occupied) > 0.9


@pytest.mark.parametrize(("metres", "free"), [(11.0, False), (16.0, True)])
def test_who_brakes_comes_to_a_halt_farther_on_than_planned(metres: float, free: bool) -> None:
    """From 8 m/s it plans to stand after 6.4 m, with its front at 10 m."""
    worth = score("comfort", driven(8.0, pull=-5.0), 8.0, occupied=box(metres))
    unhurried = score("comfort", driven(8.0, pull=-5.0), 8.0)
    assert worth == pytest.approx(unhurried if free else 0.0, abs=0.02 * unhurried)


@pytest.mark.parametrize(("curvature", "stays"), [(0.0, True), (0.2, True), (-0.2, False)])
def test_who_is_steering_to_the_right_goes_on_doing_so(curvature: float, stays: bool) -> None:
    """The road ends 3 m to the right."""
    drivable = torch.ones(1, 192, 128, 1)
    drivable[:, :, 70:] = 0.0
    start = around(5.0, drivable=drivable, curvature=torch.tensor([curvature]))
    on_road = float(judge(driven(5.0), start, CONFIG, CONFIG.score).rules.on_road)
    assert on_road > 0.9 if stays else on_road < 0.1


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


def outcome(
    *, logits: dict[str, float] | None = None, by_rules: float = 1.0, **rules: float
) -> float:
    said = dict.fromkeys(RULES, 1.0) | rules
    learnt = dict.fromkeys(LEARNT, CERTAIN) | (logits or {})
    each = torch.tensor([[*learnt.values()]])[None]
    said_by_all = Rules(*(torch.tensor([[said[name]]]) for name in RULES))
    return float(outcome_scores(each, said_by_all, torch.tensor([[by_rules]])))


def test_what_becomes_well_is_worth_one() -> None:
    assert outcome() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("logits", "rules", "worth"),
    [
        ({"nc": -CERTAIN}, {}, 0.0),
        ({"dac": -CERTAIN}, {}, 0.0),
        ({}, {"clear": 0.0}, 0.0),
        ({}, {"on_road": 0.0}, 0.0),
        ({"ep": -CERTAIN}, {}, 7 / 12),
        ({"ttc": -CERTAIN}, {}, 7 / 12),
        ({}, {"comfort": 0.0}, 10 / 12),
        ({}, {"ahead": 0.0, "progress": 0.0}, 1.0),  # which the scorer reads and outweighs
        ({"nc": 0.0}, {}, 0.125),
        ({}, {"by_rules": 0.25}, 0.5),
    ],
)
def test_sub_scores_count_as_in_the_pdm_score(
    logits: dict[str, float], rules: dict[str, float], worth: float
) -> None:
    assert outcome(logits=logits, **rules) == pytest.approx(worth, abs=1e-6)


def looks(poses: Tensor, scene: Surroundings) -> Tensor:
    """[LOOKS, T]"""
    told = met(judge(poses, scene, CONFIG, CONFIG.score).driven, scene, CONFIG)
    return told.unflatten(-1, (LOOKS, T))[0, 0]


def test_who_is_met_now_later_before_and_beside() -> None:
    """A box is on the ego's path at 2 s alone; the road runs along the columns."""
    poses, scene = driven(8.0), around(8.0)
    assert looks(poses, scene).sum() == 0
    front = poses[0, 0, 3, 0] + 0.6 * 4.6
    row = int((CONFIG.bev.extent[1] - front) / 0.5)
    scene.occupied[0, 4, row - 1 : row + 2, 62:66] = 1.0
    planned, half_ahead, whole_ahead, behind, wide = looks(poses, scene)
    assert planned.argmax() == wide.argmax() == 3
    assert planned[3] > 0.9
    assert planned[[0, 1, 5, 6]].sum() == 0
    # Half a second ahead, the layer of 2 s is looked up at the pose of 1.5 s.
    assert half_ahead.argmax() == 2
    assert whole_ahead.argmax() == 1
    assert behind.max() < 0.5

    beside = around(8.0)
    beside.occupied[0, 4, row - 1 : row + 2, 60:61] = 1.0  # 1.75 m to the left of its middle
    planned, *_, wide = looks(poses, beside)
    assert planned.max() == 0.0
    assert wide.argmax() == 3
    assert wide.max() > 0.2


def test_the_scorer_hears_of_everything() -> None:
    torch.manual_seed(0)
    model = GoalFlow(CONFIG).eval()
    poses, scene = driven(8.0), around(8.0)
    judged = judge(poses, scene, CONFIG, CONFIG.score)
    features = torch.rand(1, 48, 32, CONFIG.feature_channels)
    context = {**vars(scene), "features": features, "context": torch.zeros(1, 96)}
    told = model.told(judged, context)
    assert told.shape == (1, 1, model.outcomes.of_way.in_features)  # pyright: ignore[reportOptionalMemberAccess]
    other = dict(context, features=features + 1)
    assert (model.told(judged, other) != told).sum() == T * CONFIG.feature_channels
    context["course"] = torch.zeros(1, ROUTE_POINTS, 2)  # without a route
    states = torch.cat([poses, torch.zeros_like(poses)], -1)
    assert model.score(states, states, context).shape == (1, 1)
