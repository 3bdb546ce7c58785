"""GoalFlow on rasters of one's own: 64 channels of any size, trained, exported and served."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import failure, succeed
from exported_bundles import GOALFLOW, export_as_traced, export_once

from anchorflow_driving.errors import LogError
from anchorflow_service.bundle import load_bundle
from anchorflow_service.local import LocalClient
from anchorflow_training.checkpoint import load_checkpoint, restore_model
from anchorflow_training.driving.feature_windows import open_features
from anchorflow_training.driving.goalflow_run import GoalFlowRun, GoalFlowRunConfig
from anchorflow_training.settings import build

CHANNELS, ROWS, COLUMNS, POSES = 64, 40, 27, 2
EXTENT = (-4.0, 36.0, -13.5, 13.5)  # m, a cell of 1 m
DT, SPEED = 0.5, 14.0
WINDOWS = 12
SMALL = {"goals": 16, "picked": 3, "width": 16, "layers": 1, "channels": 8, "feature_channels": 4}


def arrays(number: int) -> dict[str, Any]:
    """A car that bends to where one of the channels is bright, at 14 m/s."""
    bend = (number % 3 - 1) * 0.05
    turned = bend * SPEED * DT * np.arange(1, POSES + 1)
    way = SPEED * DT * np.stack([np.cos(turned), np.sin(turned)], -1).cumsum(0)
    rng = np.random.default_rng(number)
    bev = rng.normal(0.0, 0.1, (CHANNELS, ROWS, COLUMNS)).astype(np.float16)
    x, y = way[-1]
    bev[5, int(EXTENT[1] - x), int(EXTENT[3] - y)] = 4.0
    ego = np.array([0, 1, 0, 0, SPEED, 0, 0, 0], np.float32)
    return {"bev": bev, "extent": np.array(EXTENT), "ego": ego, "trajectory": way, "dt": DT}


@pytest.fixture(scope="module")
def features(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("features")
    for number in range(WINDOWS):
        np.savez(folder / f"{number:03d}.npz", **arrays(number))
    return folder


OF_THE_RUN = ("name", "version", "sha256", "training")  # of a card


def small_run(folder: Path, out: Path, **settings: Any) -> GoalFlowRun:
    windows = open_features(folder)
    fixed = GoalFlowRun.model_settings(windows)
    values = {"model": {**SMALL, **fixed}, **GoalFlowRun.other_settings(windows), **settings}
    quiet = {"tensorboard": False, "accelerator": "cpu", "warmup": 0, "learning_rate": 3e-3}
    batch = {"scenes": 6, "samples": 4}
    config = build(GoalFlowRunConfig, {**quiet, "batch": batch, **values}, source="test")
    return GoalFlowRun(config, windows, out)


def test_poses_and_goals_are_those_of_the_files(features: Path, tmp_path: Path) -> None:
    as_driven = {"mirror": 0.0, "moved": 0.0, "speed": 0.0}
    run = small_run(features, tmp_path, augmentation=as_driven)
    batch = run.batch(0)
    assert batch["bev"].shape == (6, CHANNELS, ROWS, COLUMNS)
    ends = np.array([arrays(number)["trajectory"] for number in range(WINDOWS)])
    for goal, targets in zip(batch["goal"], batch["targets"], strict=True):
        which = np.linalg.norm(ends[:, -1] - goal, axis=-1).argmin()
        np.testing.assert_allclose(targets[0, :, :2], ends[which], atol=0.02)
    moved = np.array([[3.0, -2.0], [11.0, 1.0]])
    for number, goal in enumerate(moved):
        np.savez(tmp_path / f"{number}.npz", **{**arrays(number), "goal": goal})
    np.testing.assert_allclose(open_features(tmp_path).goal, moved)


def test_it_learns_where_a_channel_is_bright(features: Path, tmp_path: Path) -> None:
    run = small_run(features, tmp_path, steps=80)
    batch = run.batch(0)
    losses = [run.train_step([batch])["loss"].item() for _ in range(30)]
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])


def test_a_command_trains_what_is_exported_and_served(
    features: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Graphs and weights are those of a network that was traced before, which takes a minute."""
    small = ((f"--model.{name.replace('_', '-')}", value) for name, value in SMALL.items())
    words = ["--steps", 2, "--scenes", 4, "--held-out", 3, "--no-tensorboard", *chain(*small)]
    succeed("train", features, "--planner", "goalflow", "--out", tmp_path, *words)
    path, made = tmp_path / "checkpoint.pt", export_once("goalflow")
    assert restore_model(load_checkpoint(path)).config == replace(GOALFLOW, outcomes=False)
    options = tmp_path / "bundle", "--goal-inputs"
    bundle = export_as_traced(made, path, *options, monkeypatch=monkeypatch)
    card, wanted = load_bundle(bundle).card, load_bundle(made.path).card
    assert card == replace(wanted, **{each: getattr(card, each) for each in OF_THE_RUN})
    first = arrays(0)
    inputs = {"bev": first["bev"], "ego_status": first["ego"], "vehicle_size": [4.6, 1.9]}
    served, before = (
        LocalClient.of(each, threads=1).plan(inputs=inputs, num_samples=4, seed=0)
        for each in (bundle, made.path)
    )
    np.testing.assert_array_equal(served.trajectories, before.trajectories)
    goals = np.array([[14.0, 0.0], [13.0, 1.5]], np.float32)  # within its tyres' hold in a second
    for number in range(WINDOWS - 3, WINDOWS):  # held out
        own = {**inputs, "bev": arrays(number)["bev"], "goal": goals}
        drawn = LocalClient.of(bundle, threads=1).plan(inputs=own, num_samples=4, seed=0)
        missed = drawn.trajectories[:, -1, :2] - np.resize(goals, (4, 2))
        assert np.linalg.norm(missed, axis=-1).max() < 1.0  # m


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a.pop("trajectory"), r"001\.npz: trajectory: expected an array \[T, 2 or 3\]"),
        (lambda a: a.update(ego=np.zeros(5)), r"001\.npz: ego: expected \[8\], found \[5\]"),
        (lambda a: a.update(bev=a["bev"][:32]), r"bev: expected \(64, 40, 27\), as 000\.npz"),
        (lambda a: a.update(dt=0.4), r"dt: expected \(0\.5,\), as 000\.npz, found \(0\.4,\)"),
        (lambda a: a["trajectory"].__setitem__(0, np.nan), "trajectory: expected finite numbers"),
        (lambda a: a.update(goal=np.zeros(3)), r"goal: expected \[2\], found \[3\]"),
        (lambda a: a.update(size=np.zeros(2)), r"001\.npz: size: expected above 0"),
        (lambda a: a.update(extent=a["extent"][::-1]), "extent: expected the least x before"),
    ],
)
def test_a_window_that_does_not_fit_is_named(
    change: Callable[[dict[str, Any]], Any], said: str, tmp_path: Path
) -> None:
    wrong = arrays(1)
    change(wrong)
    np.savez(tmp_path / "000.npz", **arrays(0))
    np.savez(tmp_path / "001.npz", **wrong)
    with pytest.raises(LogError, match=said):
        open_features(tmp_path)


def test_what_needs_a_log_or_a_known_raster_is_refused(features: Path, tmp_path: Path) -> None:
    words = ("train", features, "--planner", "goalflow", "--out", tmp_path, "--steps", 1)
    said = failure(*words, "--augmentation.mirror", 0.5)
    assert "augmentation.mirror: expected 0.0, as the windows have, got 0.5" in said
    said = failure(*words, "--objective.stage", "outcomes", "--model.outcomes")
    assert "objective.stage: expected flow" in said
    said = failure(*words, "--model.bev.channels", 20)
    assert "model.bev.channels: expected 64, as the windows have, got 20" in said
