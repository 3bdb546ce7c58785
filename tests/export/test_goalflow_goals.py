"""The proof that goals stand in the order in which they are picked."""

from __future__ import annotations

import torch

from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners.goalflow import goalflow_adapter
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.goals import pick

CONFIG = GoalFlowConfig(goals=16, picked=5, width=16, channels=8, feature_channels=4, layers=1)


def test_goals_that_crowd_are_in_order_and_others_are_not() -> None:
    goals = torch.linspace(0, 4, CONFIG.goals)[:, None] * torch.tensor([1.0, 0.0])
    scores = torch.rand(CONFIG.goals, generator=torch.Generator().manual_seed(0))
    (picked,) = pick(goals, scores[None], count=CONFIG.picked, spacing=CONFIG.spacing)
    falling = scores.argsort(descending=True)
    order = torch.cat([picked, falling[~torch.isin(falling, picked)]])
    adapter = goalflow_adapter(GoalFlow(CONFIG), ExportChoices())

    def wrong(places: torch.Tensor) -> bool:
        context = {"goals": goals[places][None], "goal_scores": scores[places][None]}
        return bool(adapter._order_trial("goals", context).got.any())

    assert not wrong(order)
    for place in (0, 2, CONFIG.picked):
        swapped = order.clone()
        swapped[[place, place + 1]] = order[[place + 1, place]]
        assert wrong(swapped)
