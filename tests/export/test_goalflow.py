"""GoalFlow's adapter and the bundle that ships: the weights, the inputs, and scores that differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import ego_status
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.parity import prove_parity
from anchorflow_export.planners.goalflow import goalflow_adapter
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.local import LocalClient
from anchorflow_training.checkpoint import load_checkpoint, restore_model

SHIPPED = DEFAULT_BUNDLE.parent / "goalflow"


def test_the_spread_of_the_noise_is_the_bundles_and_not_the_networks() -> None:
    model = GoalFlow(GoalFlowConfig())
    adapter = goalflow_adapter(model, ExportChoices(noise_scale=2.0))
    assert (adapter.roles["encode"].model.noise_scale, model.noise_scale) == (2.0, 1.0)


def test_random_scenes_have_scores_that_differ() -> None:
    """Scores that are all zero would prove nothing."""
    adapter = goalflow_adapter(GoalFlow(GoalFlowConfig()), ExportChoices())
    with LocalClient.of(SHIPPED, threads=1) as client:
        inputs = adapter.request(client.engine.card, {"B": 1}, 0).inputs
        (scores,) = client.plan(inputs=inputs, num_samples=9, seed=0).scores
    assert scores.max() > 0.01
    assert scores.max() > 1.1 * scores.min()


def test_the_bundle_that_ships_takes_what_the_adapter_says() -> None:
    adapter = goalflow_adapter(GoalFlow(GoalFlowConfig()), ExportChoices())
    manifest = load_bundle(SHIPPED).manifest
    assert manifest.request.inputs == adapter.parts.inputs
    assert manifest.graphs["encode"].inputs == adapter.parts.inputs


def test_the_checkpoint_has_the_weights_of_the_bundle_that_ships() -> None:
    saved = load_checkpoint(Path(__file__).parents[2] / "checkpoints" / "goalflow.pt")
    bundle = load_bundle(SHIPPED)
    adapter = goalflow_adapter(restore_model(saved), ExportChoices())
    prove_parity(adapter, bundle, tolerance=1e-4)
    assert saved.config == bundle.manifest.training["config"]
    assert saved.step == bundle.manifest.training["steps"]


def test_at_the_greatest_speed_it_takes_the_bundle_that_ships_drives_on() -> None:
    """At 40 m/s and more it leaves its raster, however it brakes, and turns off the road."""
    bev = np.zeros((20, 192, 128), np.uint8)
    bev[0, :, 52:76] = bev[1, :, 63:65] = 255  # a straight road, and a lane that leads ahead
    inputs = {"bev": bev, "vehicle_size": np.array([4.6, 1.9], np.float32)}

    def status(speed: float) -> np.ndarray:
        return ego_status(command="straight", velocity=(speed, 0.0), acceleration=(0.0, 0.0))

    with LocalClient.of(SHIPPED, threads=1) as client:
        anchors = client.plan(inputs={**inputs, "ego_status": status(32.0)}, num_samples=64, seed=0)
        with pytest.raises(InvalidRequest, match=r"got 40\.0 at inputs\.ego_status\[4\]"):
            client.plan(inputs={**inputs, "ego_status": status(40.0)})

    plan = anchors.trajectories[anchors.best]
    assert 80.0 < plan[-1, 0] < 140.0
    assert (np.abs(plan[:, 1:]) < (0.5, 0.05)).all()
