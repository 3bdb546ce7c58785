"""A loss that is no number ends a run: step and term are named, the last checkpoint stays good."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from training_runs import QUICK

from anchorflow_cli.main import main
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.dataset import DatasetError, SceneDataset, open_dataset
from anchorflow_training.fabric import DivergenceError
from anchorflow_training.objective import FlowObjective
from anchorflow_training.trainer import CFMTrainer

CONFIG = replace(QUICK, steps=6, checkpoint_every=2)


def break_step(
    monkeypatch: pytest.MonkeyPatch, step: int, broken: Callable[[Tensor, dict], Any]
) -> None:
    """Let the objective return something else at its `step`-th call."""
    calls, forward = [], FlowObjective.forward

    def counted(self: FlowObjective, *inputs: Any) -> Any:
        calls.append(None)
        loss, terms = forward(self, *inputs)
        return broken(loss, terms) if len(calls) == step else (loss, terms)

    monkeypatch.setattr(FlowObjective, "forward", counted)


def finite(state: dict[str, Tensor]) -> bool:
    return all(bool(value.isfinite().all()) for value in state.values())


def test_a_term_that_is_no_number_ends_the_run(
    tiny_dataset: SceneDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nan = torch.tensor(torch.nan)
    break_step(monkeypatch, 4, lambda loss, terms: (loss + nan, terms | {"jerk_field": nan}))
    run = CFMTrainer(CONFIG, tiny_dataset, tmp_path)
    said = r"step 4: .*got loss nan, jerk_field nan;.*checkpoint\.pt is as it was"
    with pytest.raises(DivergenceError, match=said):
        run.fit()
    saved = load_checkpoint(run.checkpoint_path)
    assert saved.step == 2
    assert finite(saved.model)
    assert finite(run.average)
    assert [row["step"] for row in run.curve] == [1, 2, 3]

    monkeypatch.undo()
    resumed = CFMTrainer(CONFIG, tiny_dataset, tmp_path)
    resumed.fit()
    assert resumed.step == 6


def test_a_gradient_that_is_no_number_reaches_no_weight(
    tiny_dataset: SceneDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The square root of a zero is finite, its derivative is not."""
    break_step(monkeypatch, 1, lambda loss, terms: (loss + (loss - loss.detach()).sqrt(), terms))
    run = CFMTrainer(CONFIG, tiny_dataset, tmp_path)
    said = r"step 1: .*got gradient_norm (nan|inf);.*there is no checkpoint yet"
    with pytest.raises(DivergenceError, match=said):
        run.fit()
    assert finite(run.model.state_dict())


def test_the_command_says_so_in_one_line(
    write_dataset: Callable[[Path], Path], tmp_path: Path
) -> None:
    path = write_dataset(tmp_path / "data")
    clearance = np.load(path / "clearance.npy")
    clearance[:] = np.nan
    np.save(path / "clearance.npy", clearance)
    words = ["--steps=2", "--scenes=2", "--samples=2", "--no-tensorboard", "--model.map-size=16"]
    with pytest.raises(SystemExit) as caught:
        main(["train", str(path), "--out", str(tmp_path / "run"), *words])
    said = str(caught.value.code)
    assert said.startswith("anchorflow train: step 1: expected finite loss terms, got loss nan")
    assert "\n" not in said


def test_a_trajectory_that_is_no_number_is_named_with_its_scene(
    write_dataset: Callable[[Path], Path], tmp_path: Path
) -> None:
    path = write_dataset(tmp_path / "data")
    states = np.load(path / "states.npy")
    states[4, 1, 7, 0] = np.nan
    np.save(path / "states.npy", states)
    dataset = open_dataset(path)
    with pytest.raises(DatasetError, match=r"states\.npy: expected finite numbers.*scene 4"):
        CFMTrainer(CONFIG, dataset, tmp_path / "run")
    with pytest.raises(DatasetError, match=r"states\.npy: expected finite numbers.*scene 4"):
        dataset.batch(np.array([1, 4]))
    assert len(replace(dataset).batch(np.array([1, 3]))["states"]) == 2
