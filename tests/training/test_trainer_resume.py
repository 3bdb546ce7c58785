"""An interrupted run resumes as if it had not been interrupted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from training_runs import QUICK, fit_until, resumed_and_whole

from anchorflow_training.batches import Batch
from anchorflow_training.checkpoint import CheckpointError, load_checkpoint, restore_model
from anchorflow_training.config import EvaluationConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.trainer import CFMTrainer

INTERVAL = 4
CONFIG = replace(QUICK, steps=2000, warmup=10, checkpoint_every=INTERVAL)
Run = Callable[..., CFMTrainer]
PATIENCE_S = 180.0  # for a subprocess on a busy machine


@pytest.fixture
def run(tiny_dataset: SceneDataset, tmp_path: Path) -> Run:
    """Makes a run of changed settings in a folder of the test's own."""

    def make(name: str = "run", *, data: SceneDataset = tiny_dataset, **changed: Any) -> CFMTrainer:
        return CFMTrainer(replace(CONFIG, **changed), data, tmp_path / name)

    return make


def rows(out: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (out / "curve.jsonl").read_text().splitlines()]


def test_a_killed_run_loses_at_most_an_interval_and_its_curve_joins(
    tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    settings = {
        "warmup": CONFIG.warmup,
        "report-every": 1,
        "checkpoint-every": INTERVAL,
        "steps": CONFIG.steps,
        "scenes": CONFIG.batch.scenes,
        "samples": CONFIG.batch.samples,
        "model.map-size": CONFIG.model.map_size,
        "model.feature-channels": CONFIG.model.feature_channels,
        "model.layers": CONFIG.model.layers,
    }
    words = [f"--{name}={value}" for name, value in settings.items()]
    program = "from anchorflow_cli.main import main; main()"
    out = tmp_path / "cut"
    words += ["--out", str(out), "--no-tensorboard"]
    run = subprocess.Popen(
        [sys.executable, "-c", program, "train", str(tiny_dataset.path), *words],
        stdout=subprocess.DEVNULL,
    )
    try:
        curve, end = out / "curve.jsonl", time.monotonic() + PATIENCE_S
        # Stop between two checkpoints.
        while not curve.exists() or curve.read_text().count("\n") < INTERVAL + 2:
            assert run.poll() is None
            assert time.monotonic() < end
            time.sleep(0.02)
        os.kill(run.pid, signal.SIGKILL)
    finally:
        run.kill()
        run.wait()
    reached = curve.read_text().count("\n")

    resumed = CFMTrainer(CONFIG, tiny_dataset, out)
    assert reached - INTERVAL <= resumed.step <= reached
    assert resumed.step % INTERVAL == 0
    last = resumed.step + INTERVAL + 1
    fit_until(resumed, last)
    whole = CFMTrainer(CONFIG, tiny_dataset, tmp_path / "whole")
    fit_until(whole, last)

    assert [row["step"] for row in rows(out)] == list(range(1, last + 1))
    for name in ("loss", "jerk_field", "learning_rate"):
        values = [[row[name] for row in rows(run.out)] for run in (resumed, whole)]
        np.testing.assert_allclose(*values, rtol=1e-3)


def test_a_mean_that_spans_the_cut_is_that_of_an_uninterrupted_run(run: Run) -> None:
    often = {"steps": 6, "report_every": 3, "checkpoint_every": 2}
    resumed, whole = resumed_and_whole(lambda name: run(name, **often))
    assert [row["step"] for row in resumed.curve] == [3, 6]
    for name in ("loss", "gradient_norm"):
        values = [[row[name] for row in each.curve] for each in (whole, resumed)]
        np.testing.assert_allclose(*values, rtol=1e-4)
    torch.testing.assert_close(whole.average, resumed.average, rtol=1e-3, atol=1e-5)


def test_a_finished_run_changes_nothing(run: Run) -> None:
    written = []
    for _ in range(2):
        finished = run(steps=2)
        finished.fit()
        files = finished.checkpoint_path, finished.out / "curve.jsonl"
        written.append([file.read_bytes() for file in files])
    assert written[0] == written[1]


def test_another_model_is_refused_by_name(run: Run) -> None:
    run(steps=1).fit()
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt.*model\.steps_per_token 8.*got 4"):
        run(model=replace(CONFIG.model, steps_per_token=4))


def test_a_checkpoint_of_one_horizon_for_all_is_refused_in_words(run: Run) -> None:
    """Earlier models had their limits and their horizon built in; they are other networks."""
    old = run(steps=1)
    old.fit()
    saved = dict(vars(load_checkpoint(old.checkpoint_path)))
    saved["config"] = {**saved["config"], "model": {**saved["config"]["model"], "horizon_s": 8.0}}
    torch.save(saved, old.checkpoint_path)
    with pytest.raises(CheckpointError, match=r"checkpoint: .*horizon_s"):
        restore_model(load_checkpoint(old.checkpoint_path))


def test_other_data_are_refused_by_name(run: Run, tiny_dataset: SceneDataset) -> None:
    run(steps=1).fit()
    limits = {**tiny_dataset.meta["limits"], "v_max": 1.5}
    other = replace(tiny_dataset, meta={**tiny_dataset.meta, "limits": limits})
    said = r"checkpoint\.pt: limits of the data: expected .*2\.0.* got .*1\.5.*another folder"
    with pytest.raises(CheckpointError, match=said):
        run(data=other)
    more = replace(tiny_dataset, meta={**tiny_dataset.meta, "robot_radius": 0.3})
    with pytest.raises(
        CheckpointError, match=r"robot_radius of the data: expected None.* got 0\.3"
    ):
        run(data=more)


def test_another_weight_decay_is_that_of_the_rest_of_the_run(run: Run) -> None:
    run(steps=1).fit()
    resumed = run(weight_decay=0.5)
    assert [group["weight_decay"] for group in resumed.optimiser.param_groups] == [0.5]


def test_a_step_that_was_interrupted_leaves_no_gradient(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, cut = (run(name, steps=2, accumulate=2) for name in ("whole", "cut"))
    whole.fit()
    loss = cut._loss

    def interrupted(batch: Batch, part: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        if part == 1:
            raise KeyboardInterrupt
        return loss(batch, part)

    with monkeypatch.context() as patched:
        patched.setattr(cut, "_loss", interrupted)
        with pytest.raises(KeyboardInterrupt):
            cut.fit()
    cut.fit()
    norms = [[row["gradient_norm"] for row in each.curve] for each in (whole, cut)]
    np.testing.assert_allclose(*norms, rtol=1e-4)


def test_the_checkpoint_holds_the_whole_configuration(run: Run) -> None:
    finished = run(steps=1, evaluation=EvaluationConfig(held_out=1, samples=3))
    finished.fit()
    saved = load_checkpoint(finished.checkpoint_path)
    assert saved.config == asdict(finished.config)
    assert [row["step"] for row in saved.evaluations] == [1]


def test_tensorboard_shows_each_step_of_a_resumed_run_once(run: Run) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    drawn = {"steps": 5, "checkpoint_every": 2, "tensorboard": True}
    fit_until(run(**drawn), 4)
    # The next file's name holds the second in which it was opened.
    time.sleep(1.1)
    resumed = run(**drawn)
    resumed.fit()
    events = EventAccumulator(str(resumed.out / "tensorboard")).Reload()
    assert [event.step for event in events.Scalars("train/loss")] == [1, 2, 3, 4, 5]
