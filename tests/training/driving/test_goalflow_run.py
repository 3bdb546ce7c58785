"""GoalFlow learns a made-up bend: in steps that can be gone on with, and better than it began."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from driving_runs import GOALFLOW as CONFIG
from training_runs import assert_same_weights, changed_since, copied_weights, resumed_and_whole

from anchorflow_client.contract.batch import beside_route
from anchorflow_client.sensors import route_ahead
from anchorflow_driving.log import open_logs, read_log
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes
from anchorflow_models.goalflow import GoalFlow
from anchorflow_models.goalflow.config import PACES
from anchorflow_training.checkpoint import load_checkpoint, restore_model
from anchorflow_training.driving.goalflow_run import GoalFlowRun, GoalFlowRunConfig
from anchorflow_training.driving.proposals import PER_WAY, proposals
from anchorflow_training.driving.windows import DrivingWindows
from anchorflow_training.settings import ConfigError


def test_plans_may_end_earlier(windows: DrivingWindows, tmp_path: Path) -> None:
    """Six poses over 3 s."""
    short = replace(CONFIG, steps=1, model=replace(CONFIG.model, num_steps=6))
    run = GoalFlowRun(short, windows, tmp_path)
    run.fit()
    whole = GoalFlowRun(CONFIG, windows, tmp_path / "whole")
    assert run.batch(0)["targets"].shape == (3, 4, 6, 3)
    far, farther = (each.model.vocabulary[:, 0].max() for each in (run, whole))
    assert far < 0.9 * farther
    assert 0.0 <= run.evaluations[-1]["success"] <= 1.0


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


def test_the_vocabulary_lies_where_the_data_end(windows: DrivingWindows, tmp_path: Path) -> None:
    goals = GoalFlowRun(CONFIG, windows, tmp_path).model.vocabulary.numpy()

    ends = np.stack(
        [c[int(a[-1] / 1.25)] for c, a in zip(windows.course, windows.along, strict=True)]
    )
    away = np.linalg.norm(goals[:, None] - ends, axis=-1)
    assert away.min(0).max() < 6.0
    # As many to the left as to the right.
    assert abs(goals[:, 1].mean()) < 2.0


@pytest.fixture(scope="module")
def before(windows: DrivingWindows, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("flow")
    GoalFlowRun(replace(CONFIG, steps=1), windows, out).fit()
    return out / "checkpoint.pt"


@pytest.fixture
def config(before: Path) -> GoalFlowRunConfig:
    return replace(
        CONFIG,
        before=str(before),
        model=replace(CONFIG.model, outcomes=True),
        objective=replace(CONFIG.objective, stage="outcomes"),
    )


def test_proposals_are_judged_by_the_scorer_and_kept(
    windows: DrivingWindows, before: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs, model = open_logs(windows.path), restore_model(load_checkpoint(before))
    made = proposals(logs, model)
    count = model.config.ways + (PER_WAY - 1) * (model.config.picked + 1)
    assert made.trajectories.shape == (len(windows), count, 8, 3)
    window = Scenes(read_log(logs[0]))[0]
    route = route_ahead(window.view.route.points)
    strays = beside_route(made.trajectories[0, :, -1, :2], route)
    assert (strays < 0.5).sum() >= len(PACES)  # some were drawn along it
    wanted = PdmScorer(window).score(made.trajectories[0].astype(float)).sub_scores
    np.testing.assert_allclose(made.scores[0], wanted, atol=1e-3)
    assert np.ptp(made.trajectories[0], axis=0).max() > 1  # they differ

    monkeypatch.setattr("anchorflow_training.driving.proposals.drawn", None)
    again = proposals(logs, model)
    np.testing.assert_array_equal(again.trajectories, made.trajectories)


def test_the_scorer_alone_learns_and_goes_on_where_it_stopped(
    windows: DrivingWindows, config: GoalFlowRunConfig, before: Path, tmp_path: Path
) -> None:
    again, whole = resumed_and_whole(lambda name: GoalFlowRun(config, windows, tmp_path / name))
    assert_same_weights(again.model, whole.model)
    start = copied_weights(GoalFlowRun(config, windows, tmp_path / "start").model)
    changed = changed_since(start, whole.model)
    assert changed
    assert all(name.startswith("outcomes.") for name in changed)
    for name, weight in load_checkpoint(before).average.items():
        torch.testing.assert_close(whole.model.state_dict()[name], weight, rtol=0, atol=0)
    row = whole.evaluations[-1]
    assert 0 <= row["success"] <= row["best_pdms"] <= 1
    restored = restore_model(load_checkpoint(whole.checkpoint_path))
    assert isinstance(restored, GoalFlow)
    assert restored.outcomes is not None


@pytest.mark.parametrize("stage", ["flow", "outcomes"])
def test_it_learns(
    stage: str, windows: DrivingWindows, config: GoalFlowRunConfig, tmp_path: Path
) -> None:
    torch.manual_seed(0)
    config = replace({"flow": CONFIG, "outcomes": config}[stage], steps=1000)
    run = GoalFlowRun(config, windows, tmp_path)
    batch = run.batch(0)
    losses = [run.train_step([batch])["loss"].item() for _ in range(25)]
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])


def test_a_reflected_window_has_its_proposals_reflected(
    windows: DrivingWindows, config: GoalFlowRunConfig, tmp_path: Path
) -> None:
    always = replace(config.augmentation, mirror=1.0)
    never = replace(config.augmentation, mirror=0.0)
    mirrored = GoalFlowRun(replace(config, augmentation=always), windows, tmp_path / "a").batch(0)
    plain = GoalFlowRun(replace(config, augmentation=never), windows, tmp_path / "b").batch(0)
    signs = np.array([1, -1, -1], np.float32)
    np.testing.assert_array_equal(mirrored["trajectories"], plain["trajectories"] * signs)
    np.testing.assert_array_equal(mirrored["bev"][:, 0], plain["bev"][:, 0, :, ::-1])
    np.testing.assert_array_equal(mirrored["scores"], plain["scores"])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"before": None}, "before: expected a checkpoint to begin outcomes with"),
        ({"vocabulary": "goals.npy"}, "vocabulary: expected none beside before.* got goals"),
        ({"model": CONFIG.model}, r"model\.outcomes: expected true in the stage outcomes"),
        (
            {"model": replace(CONFIG.model, outcomes=True, width=64)},
            r"expected model\.width 64, got 32",
        ),
        (
            {"model": replace(CONFIG.model, outcomes=True, num_steps=6)},
            r"model\.num_steps: expected 8, for the PDM score of the stage outcomes, got 6",
        ),
    ],
)
def test_what_does_not_fit_is_named(
    changed: dict[str, Any],
    said: str,
    windows: DrivingWindows,
    config: GoalFlowRunConfig,
    tmp_path: Path,
) -> None:
    with pytest.raises(ConfigError, match=said):
        GoalFlowRun(replace(config, **changed), windows, tmp_path)
