"""The network that predicts the others learns a made-up bend, in steps that can be resumed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from training_runs import assert_same_weights, resumed_and_whole

from anchorflow_models.futures import FuturesConfig, FuturesNetwork
from anchorflow_training.batches import MirroredBatchConfig
from anchorflow_training.checkpoint import load_checkpoint, restore_model
from anchorflow_training.config import HeldOutConfig
from anchorflow_training.driving.futures_run import (
    FuturesObjective,
    FuturesObjectiveConfig,
    FuturesRun,
    FuturesRunConfig,
)
from anchorflow_training.driving.windows import DrivingWindows
from anchorflow_training.planners import TRAININGS

CONFIG = FuturesRunConfig(
    steps=2,
    warmup=0,
    report_every=1,
    checkpoint_every=1,
    tensorboard=False,
    accelerator="cpu",
    learning_rate=3e-3,
    batch=MirroredBatchConfig(scenes=3),
    evaluation=HeldOutConfig(held_out=1, scenes=1),
    model=FuturesConfig(width=16, map_channels=4),
)


def test_it_is_trained_by_its_name_on_the_raster_that_is_drawn(windows: DrivingWindows) -> None:
    assert TRAININGS["futures"].run is FuturesRun
    settings = FuturesRun.model_settings(windows)
    assert FuturesConfig(**{**settings, "bev": FuturesConfig().bev}) == FuturesConfig()
    assert settings["bev"] == vars(FuturesConfig().bev)


def test_a_run_is_judged_and_its_checkpoint_restored(
    windows: DrivingWindows, tmp_path: Path
) -> None:
    run = FuturesRun(CONFIG, windows, tmp_path)
    run.fit()
    assert isinstance(restore_model(load_checkpoint(tmp_path / "checkpoint.pt")), FuturesNetwork)
    assert 0.0 <= run.evaluations[-1]["success"] <= 1.0
    assert run.evaluations[-1]["min_ade_m"] < 40.0


def test_a_resumed_run_is_the_whole_one(windows: DrivingWindows, tmp_path: Path) -> None:
    config = replace(CONFIG, steps=4, checkpoint_every=2)
    resumed, whole = resumed_and_whole(lambda name: FuturesRun(config, windows, tmp_path / name))
    assert_same_weights(resumed.model, whole.model)


def test_it_learns_the_bend(windows: DrivingWindows, tmp_path: Path) -> None:
    longer = replace(CONFIG, steps=60, learning_rate=1e-2, report_every=10)
    run = FuturesRun(longer, windows, tmp_path)
    run.fit()
    assert run.curve[-1]["way"] < 0.5 * run.curve[0]["way"]


def test_a_mirrored_batch_is_the_reflection(windows: DrivingWindows, tmp_path: Path) -> None:
    still = replace(CONFIG, objective=FuturesObjectiveConfig(noise=0.0, shortened=0.0))
    run = FuturesRun(still, windows, tmp_path / "a")
    plain = FuturesRun(
        replace(still, batch=replace(still.batch, mirror=False)), windows, tmp_path / "b"
    )
    pairs = ((run.batch(index), plain.batch(index)) for index in range(20))
    ours, theirs = next(p for p in pairs if not np.array_equal(p[0]["bev"], p[1]["bev"]))
    np.testing.assert_array_equal(ours["others"][..., 1], -theirs["others"][..., 1])
    np.testing.assert_array_equal(ours["others"][..., 0], theirs["others"][..., 0])
    np.testing.assert_array_equal(ours["futures"][..., 1:], -theirs["futures"][..., 1:])
    np.testing.assert_array_equal(ours["bev"][:, 0], theirs["bev"][:, 0, :, ::-1])


def test_only_the_nearest_mode_learns_and_what_is_not_recorded_counts_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    poses = torch.zeros(1, 2, 2, 8, 3)
    poses[0, 0, 0, :, 0], poses[0, 0, 1, :, 0] = 1.0, 5.0
    poses.requires_grad_(True)
    truth = torch.zeros(1, 2, 8, 3)
    truth[0, 0, 4:] = torch.nan
    others = torch.zeros(1, 2, 5, 8)
    others[0, 0, :, 7] = 1  # the second is nobody
    network = FuturesNetwork(CONFIG.model)
    monkeypatch.setattr(network, "forward", lambda *_: (poses, torch.zeros(1, 2, 2)))
    config = FuturesObjectiveConfig(all_modes=0.0, likely=0.0, standing=1.0)
    objective = FuturesObjective(network, config)
    batch = {"others": others, "bev": others, "ego_status": others, "futures": truth}
    loss, _ = objective(batch)
    assert loss.item() == pytest.approx(1.0, abs=1e-3)
    loss.backward()
    gradient = poses.grad
    assert gradient is not None
    assert gradient[0, 0, 0, :4, 0].min() > 0.2
    assert not gradient[0, 0, 0, 4:].any()
    assert not gradient[0, 0, 1].any()
    assert not gradient[0, 1].any()
