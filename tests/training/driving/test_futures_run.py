"""The network that predicts the others learns a made-up bend, from the nearest mode alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from driving_runs import FUTURES as CONFIG

from anchorflow_models.futures import FuturesNetwork
from anchorflow_training.driving.futures_run import (
    FuturesObjective,
    FuturesObjectiveConfig,
    FuturesRun,
)
from anchorflow_training.driving.windows import DrivingWindows


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
