"""GoalFlow learns a made-up bend: in steps that can be gone on with, and better than it began."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from driven_bend import write_bends

from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_training.batches import SampledBatchConfig
from anchorflow_training.checkpoint import load_checkpoint, restore_model
from anchorflow_training.config import HeldOutConfig
from anchorflow_training.driving.goalflow_objective import (
    GoalFlowObjective,
    GoalFlowObjectiveConfig,
)
from anchorflow_training.driving.goalflow_run import (
    GoalFlowRun,
    GoalFlowRunConfig,
)
from anchorflow_training.driving.windows import DrivingWindows, open_windows
from anchorflow_training.planners import TRAININGS
from anchorflow_training.settings import ConfigError

CONFIG = GoalFlowRunConfig(
    steps=2,
    warmup=0,
    report_every=1,
    tensorboard=False,
    accelerator="cpu",
    batch=SampledBatchConfig(scenes=3, samples=4),
    evaluation=HeldOutConfig(held_out=1, scenes=1),
    model=GoalFlowConfig(goals=16, picked=5, width=32, channels=8, feature_channels=4),
    objective=GoalFlowObjectiveConfig(scored=12),
)


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> DrivingWindows:
    return open_windows(write_bends(tmp_path_factory.mktemp("bends"), count=2))


def test_it_is_trained_by_its_name_on_the_raster_that_is_drawn(windows: DrivingWindows) -> None:
    training = TRAININGS["goalflow"]

    assert training.config is GoalFlowRunConfig
    assert GoalFlowRun.model_settings(windows)["bev"] == vars(GoalFlowConfig().bev)


def test_a_run_is_judged_and_its_checkpoint_restored(
    windows: DrivingWindows, tmp_path: Path
) -> None:
    run = GoalFlowRun(CONFIG, windows, tmp_path)
    run.fit()

    restored = restore_model(load_checkpoint(tmp_path / "checkpoint.pt"))
    assert isinstance(restored, GoalFlow)
    torch.testing.assert_close(restored.vocabulary, run.model.vocabulary)
    torch.testing.assert_close(restored.stray, run.model.stray)
    assert 0.0 <= run.evaluations[-1]["success"] <= 1.0
    assert run.evaluations[-1]["best_ade_m"] < 20.0


def test_a_log_that_is_judged_on_is_not_trained_on(windows: DrivingWindows, tmp_path: Path) -> None:
    assert (windows.log == 1).sum() > 1  # one is held out
    run = GoalFlowRun(CONFIG, windows, tmp_path)
    assert set(windows.log[: run.count]) == {0}
    assert set(windows.log[run.count :]) == {1}


def test_all_that_is_judged_may_stand(
    windows: DrivingWindows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = GoalFlowRun(CONFIG, windows, tmp_path)
    monkeypatch.setattr(run, "judged", lambda *_: {"success": np.nan, "best_ade_m": 1.0})
    assert run.evaluate(run.model)[0] == {"success": 0.0, "best_ade_m": 1.0}


def test_a_batch_is_the_same_whenever_it_is_asked_for(
    windows: DrivingWindows, tmp_path: Path
) -> None:
    run = GoalFlowRun(CONFIG, windows, tmp_path)
    first, again = run.batch(3), list(run.stream([2, 3]))[1]

    for name, array in first.items():
        np.testing.assert_array_equal(again[name], array)


def test_the_vocabulary_lies_where_the_data_end(windows: DrivingWindows, tmp_path: Path) -> None:
    goals = GoalFlowRun(CONFIG, windows, tmp_path).model.vocabulary.numpy()

    ends = np.stack(
        [c[int(a[-1] / 1.25)] for c, a in zip(windows.course, windows.along, strict=True)]
    )
    away = np.linalg.norm(goals[:, None] - ends, axis=-1)
    assert away.min(0).max() < 6.0
    # As many to the left as to the right.
    assert abs(goals[:, 1].mean()) < 2.0


def test_it_learns(windows: DrivingWindows, tmp_path: Path) -> None:
    torch.manual_seed(0)
    run = GoalFlowRun(replace(CONFIG, steps=1000, learning_rate=3e-3), windows, tmp_path)
    batch = run.batch(0)
    losses = [run.train_step([batch])["loss"].item() for _ in range(25)]

    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])


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


def test_too_few_windows_are_named(windows: DrivingWindows, tmp_path: Path) -> None:
    config = replace(CONFIG, batch=SampledBatchConfig(scenes=64, samples=4))
    with pytest.raises(ConfigError, match=r"batch.scenes: expected at most \d+, the windows of"):
        GoalFlowRun(config, windows, tmp_path)
