"""GoalFlow on camera and LiDAR: trained on what is kept beside the logs, exported and served."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from command_line import failure, succeed
from drawn_bend import drawn
from driving_runs import SENSORS as CONFIG
from exported_bundles import NETWORKS, SENSING, export_as_traced, export_once
from training_runs import changed_since, copied_weights

from anchorflow_driving.window import Window
from anchorflow_export.planners.random_requests import street_request
from anchorflow_models.goalflow import GoalFlowConfig
from anchorflow_service.bundle import load_bundle
from anchorflow_service.local import LocalClient
from anchorflow_training.batches import batch_scenes
from anchorflow_training.checkpoint import (
    Checkpoint,
    load_checkpoint,
    restore_model,
    save_checkpoint,
)
from anchorflow_training.driving import sensor_windows
from anchorflow_training.driving.augmentation import AugmentationConfig
from anchorflow_training.driving.goalflow_objective import GoalFlowObjectiveConfig
from anchorflow_training.driving.goalflow_run import GoalFlowRun
from anchorflow_training.driving.sensor_windows import Drawn, SensorSizes
from anchorflow_training.driving.windows import DrivingWindows
from anchorflow_training.pretrained import sight_of
from anchorflow_training.settings import ConfigError, config_text


def shown(window: Window, sizes: SensorSizes) -> Drawn:
    """Without a graphics driver: its number in all pictures, and the left edge of the camera's."""
    told = drawn(window, sizes, agents=4)
    told["camera"][..., 0] = 200
    return told


@pytest.fixture(autouse=True)
def _shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensor_windows, "sensed", shown)


def test_pictures_are_of_their_window_and_are_reflected_with_it(
    windows: DrivingWindows, tmp_path: Path
) -> None:
    run = GoalFlowRun(CONFIG, windows, tmp_path)
    assert run.sensors is not None
    reflected = []
    for index in range(4):
        batch, chosen = run.batch(index), batch_scenes(run.count, CONFIG.batch, index)
        own = run.sensors.batch(chosen)
        for scene, is_mirrored in enumerate(batch["mirrored"]):
            side = slice(None, None, -1 if is_mirrored else 1)
            for name in ("camera", "lidar"):
                np.testing.assert_array_equal(batch[name][scene], own[name][scene, ..., side])
            bends = np.sign([batch["course"][scene, -1, 1], windows.course[chosen[scene], -1, 1]])
            assert (bends[0] == bends[1]) != is_mirrored
        np.testing.assert_array_equal(batch["ego_status"], batch["status"])
        reflected += [*batch["mirrored"]]
    assert {*reflected} == {True, False}
    told = ["lidar_before" in run.batch(index) for index in range(40)]
    assert 0 < told.count(False) < 15


def test_the_raster_teaches_what_sensors_show(windows: DrivingWindows, tmp_path: Path) -> None:
    run = GoalFlowRun(replace(CONFIG, steps=1000), windows, tmp_path)
    batch = run.batch(0)
    steps = [run.train_step([batch]) for _ in range(25)]
    for name, falls in {"loss": 0.7, "road": 0.5, "others": 0.2}.items():
        assert steps[-1][name] < falls * steps[0][name], name


def test_it_begins_with_another_planners_perception_and_keeps_it(
    windows: DrivingWindows, tmp_path: Path
) -> None:
    other, path = NETWORKS["diffusiondrive"](), tmp_path / "other.pt"
    weights = other.state_dict()
    save_checkpoint(path, Checkpoint(1, {}, {}, {}, weights, {}, []))
    config = replace(CONFIG, steps=1, perception=str(path), frozen_perception=True)
    run = GoalFlowRun(config, windows, tmp_path)
    start = copied_weights(run.model)
    run.fit()
    changed = changed_since(start, run.model)
    assert {name.partition(".")[0] for name in changed} == {
        "scene",
        "scorer",
        "flow",
        "surface_head",
    }
    sight = sight_of(other)
    assert {*sight_of(run.model)} == {"backbone", "ground"}
    for name, part in sight_of(run.model).items():
        torch.testing.assert_close(part.state_dict(), sight[name].state_dict(), rtol=0, atol=0)


def test_a_command_trains_what_is_exported_and_served(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Graphs and weights are those of a network that was traced before, which takes a minute."""
    (tmp_path / "small.yaml").write_text(config_text(replace(CONFIG, steps=2)))
    succeed("data", "sensors", folder, "--config", tmp_path / "small.yaml")
    succeed("train", folder, "--config", tmp_path / "small.yaml", "--out", tmp_path)
    path, made = tmp_path / "checkpoint.pt", export_once("goalflow-sensors")
    assert restore_model(load_checkpoint(path)).config == CONFIG.model
    bundle = export_as_traced(made, path, tmp_path / "bundle", monkeypatch=monkeypatch)
    opened = load_bundle(bundle)
    assert opened.manifest.training["data"]["sensors"] == "simulated"
    names = ["camera", "lidar", "ego_status", "lidar_before", "vehicle_size", "route"]
    assert [spec.name for spec in opened.card.inputs] == names
    inputs = street_request(SENSING.bev, opened.card, {"B": 1}, 0).inputs
    served, before = (
        LocalClient.of(each, threads=1).plan(inputs=inputs, num_samples=4, seed=0)
        for each in (bundle, made.path)
    )
    np.testing.assert_array_equal(served.trajectories, before.trajectories)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"augmentation": AugmentationConfig()}, "augmentation.moved: expected 0 .*, got 0.5"),
        (
            {
                "before": "run.pt",
                "model": replace(CONFIG.model, outcomes=True),
                "objective": GoalFlowObjectiveConfig("outcomes"),
            },
            "objective.stage: expected flow with model.sensors, got outcomes",
        ),
        (
            {"model": GoalFlowConfig(), "frozen_perception": True},
            "frozen_perception: expected none without model.sensors, got True",
        ),
        (
            {"model": GoalFlowConfig(), "perception": "wote.pt"},
            "perception: expected none without model.sensors, got wote.pt",
        ),
    ],
)
def test_what_sensors_cannot_do_is_refused(
    changed: dict[str, Any], said: str, windows: DrivingWindows, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=said):
        GoalFlowRun(replace(CONFIG, **changed), windows, tmp_path)


def test_a_planner_without_them_has_none_to_draw(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "blind.yaml").write_text("planner: goalflow\n")
    said = failure("data", "sensors", folder, "--config", tmp_path / "blind.yaml")
    assert "expected one that sees by camera and LiDAR, got 'goalflow'" in said
