"""The losses of GoalFlow, each against what the hand works out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from driven_bend import write_bends
from torch import Tensor

from anchorflow_client.contract.batch import beside_route
from anchorflow_client.sensors import route_ahead
from anchorflow_driving.errors import LogError
from anchorflow_driving.log import read_log
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.config import PACES
from anchorflow_training.batches import SampledBatchConfig
from anchorflow_training.checkpoint import load_checkpoint, restore_model
from anchorflow_training.config import HeldOutConfig
from anchorflow_training.driving.goalflow_objective import (
    GoalFlowObjective,
    GoalFlowObjectiveConfig,
)
from anchorflow_training.driving.goalflow_run import GoalFlowRun, GoalFlowRunConfig
from anchorflow_training.driving.log_cache import open_logs
from anchorflow_training.driving.proposals import PER_WAY, proposals
from anchorflow_training.driving.windows import DrivingWindows, open_windows
from anchorflow_training.settings import ConfigError

T = 8
AHEAD = torch.stack([torch.arange(5.0, 45.0, 5.0), torch.zeros(T), torch.zeros(T)], -1)
"""Poses of an ego that drives straight at 10 m/s."""


@pytest.fixture
def objective() -> GoalFlowObjective:
    """An untrained flow predicts the way that it begins on; every goal is at its end."""
    model = GoalFlow(GoalFlowConfig(goals=8, picked=1, width=16, channels=8, feature_channels=4))
    with torch.no_grad():
        model.vocabulary.copy_(AHEAD[-1, :2].expand(8, -1))
        model.scorer.out.weight.zero_()
        model.scorer.out.bias.fill_(1.0)
    return GoalFlowObjective(model, GoalFlowObjectiveConfig(scored=8))


def terms(
    objective: GoalFlowObjective, targets: Tensor, *, t: float = 0.0, **changed: Tensor
) -> dict[str, Tensor]:
    """The batch of one target [B, T, 3] a window, learnt without a goal."""
    B = len(targets)
    bev = torch.zeros(B, 20, 192, 128, dtype=torch.uint8)
    bev[:, 0] = 255
    batch = {
        "bev": bev,
        "moved": torch.zeros(B, 3),
        "status": torch.tensor([[0.0, 1, 0, 0, 10, 0, 0, 0]]).expand(B, -1),
        "size": torch.tensor([[4.6, 1.9]]).expand(B, -1),
        "course": torch.tensor([[0.0, 0.0], [80.0, 0.0]]).expand(B, -1, -1),
        "targets": targets[:, None],
    }
    noise, _, jitter, chance = objective.draw(B, 1, torch.Generator().manual_seed(0))
    return objective({**batch, **changed}, noise, torch.full((B, 1), t), jitter, chance)[1]


@pytest.mark.parametrize(
    ("t", "strays", "wanted"),
    [
        (0.0, 1.5, 1.5**2),
        (0.5, 1.5, 3.0**2),
        (0.9, 1.5, 5.0**2),  # as with 0.3 left
        (0.5, -8.0, 10.0**2),  # and no error counts for more than 10
    ],
)
def test_a_flow_is_off_by_its_error_over_the_time_that_is_left(
    objective: GoalFlowObjective, t: float, strays: float, wanted: float
) -> None:
    targets = AHEAD + strays * objective.model.stray
    assert terms(objective, targets[None], t=t)["flow"].item() == pytest.approx(wanted, rel=1e-4)


def test_ways_are_near_the_recorded_end_on_the_road_and_on_the_route_or_not(
    objective: GoalFlowObjective,
) -> None:
    bev = torch.zeros(2, 20, 192, 128, dtype=torch.uint8)
    bev[:, 0] = 255
    bev[1, 0, :76] = 0  # the road ends at 42 m, under the ego's front
    course = torch.tensor([[[0.0, 0.0], [80.0, 0.0]], [[0.0, 0.0], [38.8, 0.0]]])
    targets = torch.stack([AHEAD, AHEAD + torch.tensor([0.0, 2.0, 0.0])])
    told = terms(objective, targets, bev=bev, course=course)

    # The cross-entropy of logit 1 is log(1 + e) less the label, 1 in the first window.
    second = {"distance": math.exp(-0.5), "drivable": 0.0, "route": math.exp(-0.5)}
    for name, share in second.items():
        wanted = math.log(1 + math.e) - (1 + share) / 2
        assert told[name].item() == pytest.approx(wanted, abs=1e-4), name


FLOW = GoalFlowRunConfig(
    steps=2,
    warmup=0,
    report_every=1,
    checkpoint_every=1,
    tensorboard=False,
    accelerator="cpu",
    learning_rate=3e-3,
    batch=SampledBatchConfig(scenes=3, samples=4),
    evaluation=HeldOutConfig(held_out=1, scenes=1),
    model=GoalFlowConfig(goals=16, picked=5, width=32, channels=8, feature_channels=4),
    objective=GoalFlowObjectiveConfig(scored=12),
)


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> DrivingWindows:
    return open_windows(write_bends(tmp_path_factory.mktemp("bends"), count=2))


@pytest.fixture(scope="module")
def before(windows: DrivingWindows, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("flow")
    GoalFlowRun(FLOW, windows, out).fit()
    return out / "checkpoint.pt"


@pytest.fixture
def config(before: Path) -> GoalFlowRunConfig:
    return replace(
        FLOW,
        before=str(before),
        model=replace(FLOW.model, outcomes=True),
        objective=replace(FLOW.objective, stage="outcomes"),
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

    (kept,) = logs[0].parent.glob(f"{logs[0].stem}.proposals-*")
    whole = kept.read_bytes()
    kept.write_bytes(whole[:200] + bytes([whole[200] ^ 1]) + whole[201:])
    with pytest.raises(LogError, match=f"{kept}: file: expected an .npz .*, found Bad CRC"):
        proposals(logs, model)
    kept.write_bytes(whole)


def test_the_scorer_alone_learns_and_goes_on_where_it_stopped(
    windows: DrivingWindows, config: GoalFlowRunConfig, before: Path, tmp_path: Path
) -> None:
    whole = GoalFlowRun(config, windows, tmp_path / "whole")
    start = {name: weight.clone() for name, weight in whole.model.state_dict().items()}
    whole.fit()
    changed = {n for n, w in whole.model.state_dict().items() if not torch.equal(w, start[n])}
    assert changed
    assert all(name.startswith("outcomes.") for name in changed)
    for name, weight in load_checkpoint(before).average.items():
        torch.testing.assert_close(whole.model.state_dict()[name], weight, rtol=0, atol=0)
    row = whole.evaluations[-1]
    assert 0 <= row["success"] <= row["best_pdms"] <= 1

    GoalFlowRun(replace(config, steps=1), windows, tmp_path / "cut").fit()
    cut = load_checkpoint(tmp_path / "cut" / "checkpoint.pt")
    assert cut.step == 1
    again = GoalFlowRun(config, windows, tmp_path / "cut")
    again.fit()
    assert again.step == config.steps
    restored = restore_model(load_checkpoint(tmp_path / "whole" / "checkpoint.pt"))
    assert isinstance(restored, GoalFlow)
    assert restored.outcomes is not None


def test_it_learns(windows: DrivingWindows, config: GoalFlowRunConfig, tmp_path: Path) -> None:
    run = GoalFlowRun(replace(config, steps=1000), windows, tmp_path)
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


def test_what_does_not_fit_is_named(
    windows: DrivingWindows, config: GoalFlowRunConfig, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="before: expected a checkpoint to begin outcomes with"):
        GoalFlowRun(replace(config, before=None), windows, tmp_path)
    with pytest.raises(ConfigError, match=r"vocabulary: expected none beside before.* got goals"):
        GoalFlowRun(replace(config, vocabulary="goals.npy"), windows, tmp_path)
    with pytest.raises(ConfigError, match=r"model\.outcomes: expected true in the stage outcomes"):
        GoalFlowRun(replace(config, model=FLOW.model), windows, tmp_path)
    wide = replace(config.model, width=64)
    with pytest.raises(ConfigError, match=r"expected model\.width 64, got 32"):
        GoalFlowRun(replace(config, model=wide), windows, tmp_path)
