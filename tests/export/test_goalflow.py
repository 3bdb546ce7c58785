"""The proof of a GoalFlow: goals in the order in which they are picked, scores that tell apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from anchorflow_export.adapter import ExportChoices
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.planners.goalflow import goalflow_adapter
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.goals import pick
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.local import LocalClient

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


@pytest.mark.parametrize("outcomes", [False, True])
def test_random_scenes_have_scores_that_differ(outcomes: bool) -> None:
    """Nothing would be proved by scores that are all nought."""
    torch.manual_seed(0)
    adapter = goalflow_adapter(GoalFlow(replace(CONFIG, outcomes=outcomes)), ExportChoices())
    for seed in range(4):
        context = adapter.model.encode(**adapter.random_inputs(1, seed=seed))
        mean, x = adapter._beginning(context, torch.randn(8, context["prior_basis"].shape[1]))
        scores = adapter.model.score(x, mean, context)
        assert scores.max() > 0.005  # of a chance of a half to hit somebody an eighth is left
        assert scores.max() > 1.1 * scores.min()


def test_scores_by_the_rules_are_proved(tmp_path: Path) -> None:
    """Those of what is learnt are by the bundle that is served in tests/service/http."""
    adapter = goalflow_adapter(GoalFlow(CONFIG).eval(), ExportChoices())
    description = BundleDescription(name="goalflow", version="1", planner="goalflow")
    differences = export_bundle(adapter, description, out=tmp_path / "bundle")
    proved = [each for each in differences if "score" in each.what]
    assert proved
    assert max(each.error for each in proved) < 1e-4


def test_the_scorer_that_ships_tells_random_scenes_apart() -> None:
    """What it has never seen the like of it takes for nought, and that would prove nothing."""
    adapter = goalflow_adapter(GoalFlow(GoalFlowConfig()), ExportChoices())
    inputs = {name: tensor[0].numpy() for name, tensor in adapter.random_inputs(1, seed=0).items()}
    with LocalClient.of(DEFAULT_BUNDLE.parent / "goalflow", threads=1) as client:
        scores = client.plan(inputs=inputs, num_samples=9, seed=0).scores
    assert scores.max() > 0.01
    assert scores.max() > 2 * scores.min()
