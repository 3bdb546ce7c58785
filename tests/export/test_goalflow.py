"""The proof of a GoalFlow: goals in the order in which they are picked, scores that tell apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from anchorflow_client.contract import TensorSpec
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import ego_status
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.parity import prove_parity
from anchorflow_export.planners.goalflow import goalflow_adapter
from anchorflow_export.tracing import trace_role
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.goals import pick
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.local import LocalClient
from anchorflow_training.checkpoint import load_checkpoint, restore_model

CONFIG = GoalFlowConfig(
    num_steps=2, goals=16, picked=5, width=16, channels=8, feature_channels=4, layers=1
)


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


def test_the_spread_of_the_noise_is_the_bundles_and_not_the_networks() -> None:
    model = GoalFlow(CONFIG)
    adapter = goalflow_adapter(model, ExportChoices(noise_scale=2.0))
    assert (adapter.model.noise_scale, model.noise_scale) == (2.0, 1.0)


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


def test_scores_by_the_rules_are_proved() -> None:
    """Those of what is learnt are by the bundle that is served in tests/service/http."""
    model = GoalFlow(CONFIG).eval()
    adapter = goalflow_adapter(model, ExportChoices())
    with torch.no_grad():
        context = model.encode(**adapter.random_inputs(3, seed=0))
        mean, x_1 = adapter._beginning(context, torch.randn(7, context["prior_basis"].shape[1]))
        wanted = model.score(x_1, mean, context).numpy()
    told = {"x_1": x_1, "prior_mean": mean, **{n: context[n] for n in model.context_for_score}}
    inputs = [
        TensorSpec(name, str(each.dtype).removeprefix("torch."), _axes(name, each.shape))
        for name, each in told.items()
    ]
    graph = trace_role(model, "score", inputs=inputs, outputs=("scores",))
    session = onnxruntime.InferenceSession(graph.model.SerializeToString())
    fed = {spec.name: told[spec.name].numpy() for spec in session.get_inputs()}
    (got,) = session.run(None, fed)
    np.testing.assert_allclose(np.asarray(got), wanted, atol=1e-5)
    assert wanted.max() > 1.1 * wanted.min()


def _axes(name: str, shape: torch.Size) -> tuple[str | int, ...]:
    per_anchor = name in ("x_1", "prior_mean")
    return ("B", "N", *shape[2:]) if per_anchor else ("B", *shape[1:])


def test_the_bundle_that_ships_takes_what_the_adapter_says() -> None:
    adapter = goalflow_adapter(GoalFlow(GoalFlowConfig()), ExportChoices())
    manifest = load_bundle(DEFAULT_BUNDLE.parent / "goalflow").manifest
    assert manifest.request.inputs == adapter.inputs
    assert manifest.graphs["encode"].inputs == adapter.inputs


def test_the_checkpoint_has_the_weights_of_the_bundle_that_ships() -> None:
    saved = load_checkpoint(Path(__file__).parents[2] / "checkpoints" / "goalflow.pt")
    bundle = load_bundle(DEFAULT_BUNDLE.parent / "goalflow")
    adapter = goalflow_adapter(restore_model(saved), ExportChoices())
    prove_parity(adapter, bundle, tolerance=1e-4)
    assert saved.config == bundle.manifest.training["config"]
    assert saved.step == bundle.manifest.training["steps"]


def test_at_the_greatest_speed_it_takes_the_bundle_that_ships_drives_on() -> None:
    """From 40 m/s on it leaves its raster, however it brakes, and turns off the road."""
    bev = np.zeros((20, 192, 128), np.uint8)
    bev[0, :, 52:76] = bev[1, :, 63:65] = 255  # a straight road, and a lane that leads ahead
    inputs = {"bev": bev, "vehicle_size": np.array([4.6, 1.9], np.float32)}

    def status(speed: float) -> np.ndarray:
        return ego_status(command="straight", velocity=(speed, 0.0), acceleration=(0.0, 0.0))

    with LocalClient.of(DEFAULT_BUNDLE.parent / "goalflow", threads=1) as client:
        anchors = client.plan(inputs={**inputs, "ego_status": status(32.0)}, num_samples=64, seed=0)
        with pytest.raises(InvalidRequest, match=r"got 40\.0 at inputs\.ego_status\[4\]"):
            client.plan(inputs={**inputs, "ego_status": status(40.0)})

    plan = anchors.trajectories[anchors.best]
    assert 80.0 < plan[-1, 0] < 140.0
    assert (np.abs(plan[:, 1:]) < (0.5, 0.05)).all()


def test_the_scorer_that_ships_tells_random_scenes_apart() -> None:
    """What it has never seen the like of it takes for nought, and that would prove nothing."""
    adapter = goalflow_adapter(GoalFlow(GoalFlowConfig()), ExportChoices())
    inputs = {name: tensor[0].numpy() for name, tensor in adapter.random_inputs(1, seed=0).items()}
    with LocalClient.of(DEFAULT_BUNDLE.parent / "goalflow", threads=1) as client:
        scores = client.plan(inputs=inputs, num_samples=9, seed=0).scores
    assert scores.max() > 0.01
    assert scores.max() > 2 * scores.min()
