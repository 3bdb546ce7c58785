"""Scores of what is learnt to become of a trajectory: what they keep, what they are learnt of."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from anchorflow_client.sensors import ROUTE_POINTS
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.kinematics import roll_out
from anchorflow_models.goalflow.outcome_scorer import LEARNT, outcome_scores
from anchorflow_models.goalflow.trajectory_score import (
    LOOKS,
    RULES,
    Rules,
    Surroundings,
    judge,
    met,
)

CONFIG = GoalFlowConfig(
    goals=16, picked=5, width=16, channels=8, feature_channels=4, layers=1, outcomes=True
)
T = CONFIG.num_steps
SURE = 100.0


def score(
    *, logits: dict[str, float] | None = None, by_rules: float = 1.0, **rules: float
) -> float:
    said = dict.fromkeys(RULES, 1.0) | rules
    learnt = dict.fromkeys(LEARNT, SURE) | (logits or {})
    each = torch.tensor([[*learnt.values()]])[None]
    said_by_all = Rules(*(torch.tensor([[said[name]]]) for name in RULES))
    return float(outcome_scores(each, said_by_all, torch.tensor([[by_rules]])))


def test_what_becomes_well_is_worth_one() -> None:
    assert score() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("logits", "rules", "worth"),
    [
        ({"nc": -SURE}, {}, 0.0),
        ({"dac": -SURE}, {}, 0.0),
        ({}, {"clear": 0.0}, 0.0),
        ({}, {"on_road": 0.0}, 0.0),
        ({"ep": -SURE}, {}, 7 / 12),
        ({"ttc": -SURE}, {}, 7 / 12),
        ({}, {"comfort": 0.0}, 10 / 12),
        ({}, {"ahead": 0.0, "progress": 0.0}, 1.0),  # which the scorer reads and outweighs
        ({"nc": 0.0}, {}, 0.125),
        ({}, {"by_rules": 0.25}, 0.5),
    ],
)
def test_sub_scores_count_as_in_the_pdm_score(
    logits: dict[str, float], rules: dict[str, float], worth: float
) -> None:
    assert score(logits=logits, **rules) == pytest.approx(worth, abs=1e-6)


def along(speed: float) -> tuple[Tensor, Surroundings]:
    """Return a straight drive at a steady speed on an empty road."""
    controls = torch.zeros(1, 1, T)
    poses = roll_out(torch.tensor([[speed]]), controls, controls, dt=CONFIG.dt)
    bev = CONFIG.bev
    around = Surroundings(
        drivable=torch.ones(1, bev.rows, bev.columns, 1),
        occupied=torch.zeros(1, 1 + bev.foretold, bev.rows, bev.columns),
        speed=torch.tensor([speed]),
        acceleration=torch.zeros(1),
        curvature=torch.zeros(1),
        size=torch.tensor([[4.6, 1.9]]),
    )
    return poses, around


def looks(poses: Tensor, around: Surroundings) -> Tensor:
    """[LOOKS, T]"""
    told = met(judge(poses, around, CONFIG).driven, around, CONFIG)
    return told.unflatten(-1, (LOOKS, T))[0, 0]


def test_who_is_met_now_later_before_and_beside() -> None:
    """Return a box on the ego's path at 2 s alone; the road runs along the columns."""
    poses, around = along(8.0)
    assert looks(poses, around).sum() == 0
    front = poses[0, 0, 3, 0] + 0.6 * 4.6
    row = int((CONFIG.bev.extent[1] - front) / 0.5)
    around.occupied[0, 4, row - 1 : row + 2, 62:66] = 1.0
    planned, half_ahead, whole_ahead, behind, wide = looks(poses, around)
    assert planned.argmax() == wide.argmax() == 3
    assert planned[3] > 0.9
    assert planned[[0, 1, 5, 6]].sum() == 0
    # Half a second ahead, the layer of 2 s is looked up at the pose of 1.5 s.
    assert half_ahead.argmax() == 2
    assert whole_ahead.argmax() == 1
    assert behind.max() < 0.5

    beside = replace(around, occupied=torch.zeros_like(around.occupied))
    beside.occupied[0, 4, row - 1 : row + 2, 60:61] = 1.0  # 1.75 m to the left of its middle
    planned, *_, wide = looks(poses, beside)
    assert planned.max() == 0.0
    assert wide.argmax() == 3
    assert wide.max() > 0.2


def test_the_scorer_hears_of_everything() -> None:
    torch.manual_seed(0)
    model = GoalFlow(CONFIG).eval()
    poses, around = along(8.0)
    judged = judge(poses, around, CONFIG)
    features = torch.rand(1, 48, 32, CONFIG.feature_channels)
    context = {**vars(around), "features": features, "context": torch.zeros(1, 96)}
    told = model.told(judged, context)
    assert told.shape == (1, 1, model.outcomes.of_way.in_features)  # pyright: ignore[reportOptionalMemberAccess]
    other = dict(context, features=features + 1)
    assert (model.told(judged, other) != told).sum() == T * CONFIG.feature_channels
    context["course"] = torch.zeros(1, ROUTE_POINTS, 2)  # without a route
    assert model.score(poses_as_states(poses), poses_as_states(poses), context).shape == (1, 1)


def poses_as_states(poses: Tensor) -> Tensor:
    return torch.cat([poses, torch.zeros_like(poses)], -1)
