"""The losses of GoalFlow, each against what the hand works out."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_training.driving.goalflow_objective import (
    GoalFlowObjective,
    GoalFlowObjectiveConfig,
)

T = 8
AHEAD = torch.stack([torch.arange(5.0, 45.0, 5.0), torch.zeros(T), torch.zeros(T)], -1)
"""Poses of an ego that drives straight at 10 m/s."""


@pytest.fixture
def objective() -> GoalFlowObjective:
    """An untrained flow predicts the way that it begins on; every goal is at its end."""
    model = GoalFlow(GoalFlowConfig(goals=8, picked=1, width=16, channels=8, feature_channels=4))
    with torch.no_grad():
        model.vocabulary.copy_(AHEAD[-1, :2].expand(8, -1))
        model.scorer.out.weight.zero_()
        model.scorer.out.bias.fill_(1.0)
    return GoalFlowObjective(model, GoalFlowObjectiveConfig(scored=8))


def terms(
    objective: GoalFlowObjective, targets: Tensor, *, t: float = 0.0, **changed: Tensor
) -> dict[str, Tensor]:
    """The batch of one target [B, T, 3] a window, learnt without a goal."""
    B = len(targets)
    bev = torch.zeros(B, 20, 192, 128, dtype=torch.uint8)
    bev[:, 0] = 255
    batch = {
        "bev": bev,
        "moved": torch.zeros(B, 3),
        "status": torch.tensor([[0.0, 1, 0, 0, 10, 0, 0, 0]]).expand(B, -1),
        "size": torch.tensor([[4.6, 1.9]]).expand(B, -1),
        "course": torch.tensor([[0.0, 0.0], [80.0, 0.0]]).expand(B, -1, -1),
        "targets": targets[:, None],
    }
    noise, _, jitter, chance = objective.draw(B, 1, torch.Generator().manual_seed(0))
    return objective({**batch, **changed}, noise, torch.full((B, 1), t), jitter, chance)[1]


@pytest.mark.parametrize(
    ("t", "strays", "wanted"),
    [
        (0.0, 1.5, 1.5**2),
        (0.5, 1.5, 3.0**2),
        (0.9, 1.5, 5.0**2),  # as with 0.3 left
        (0.5, -8.0, 10.0**2),  # and no error counts for more than 10
    ],
)
def test_a_flow_is_off_by_its_error_over_the_time_that_is_left(
    objective: GoalFlowObjective, t: float, strays: float, wanted: float
) -> None:
    targets = AHEAD + strays * objective.model.stray
    assert terms(objective, targets[None], t=t)["flow"].item() == pytest.approx(wanted, rel=1e-4)


def test_ways_are_near_the_recorded_end_on_the_road_and_on_the_route_or_not(
    objective: GoalFlowObjective,
) -> None:
    bev = torch.zeros(2, 20, 192, 128, dtype=torch.uint8)
    bev[:, 0] = 255
    bev[1, 0, :76] = 0  # the road ends at 42 m, under the ego's front
    course = torch.tensor([[[0.0, 0.0], [80.0, 0.0]], [[0.0, 0.0], [38.8, 0.0]]])
    targets = torch.stack([AHEAD, AHEAD + torch.tensor([0.0, 2.0, 0.0])])
    told = terms(objective, targets, bev=bev, course=course)

    # The cross-entropy of logit 1 is log(1 + e) less the label, 1 in the first window.
    second = {"distance": math.exp(-0.5), "drivable": 0.0, "route": math.exp(-0.5)}
    for name, share in second.items():
        wanted = math.log(1 + math.e) - (1 + share) / 2
        assert told[name].item() == pytest.approx(wanted, abs=1e-4), name


def test_a_raster_moves_with_its_start() -> None:
    model = GoalFlow(GoalFlowConfig(goals=16, picked=5, channels=8))
    objective = GoalFlowObjective(model, GoalFlowObjectiveConfig(scored=12))
    bev = torch.zeros(2, 20, 192, 128, dtype=torch.uint8)
    bev[:, 0, 100, 60] = 255  # 29.75 m ahead, 1.75 m to the left
    moved = objective.moved(bev, torch.tensor([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))

    assert moved[0, 0, 100, 60] == 255
    # Who stands 1 m to the left sees it two cells further to the right.
    assert moved[1, 0, 100, 62].item() == pytest.approx(255, rel=0.01)
    turned = objective.moved(bev, torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]))[1, 0]
    row, column = divmod(int(turned.argmax()), 128)
    x, y = 80 - 0.5 * (row + 0.5), 32 - 0.5 * (column + 0.5)
    assert (x, y) == pytest.approx((29.6 + 0.17, 1.74 - 2.97), abs=0.4)
