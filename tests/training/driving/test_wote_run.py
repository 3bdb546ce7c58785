"""WoTE learns from logs: sensors and scores kept beside them, and what a run begins with."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from drawn_bend import drawn
from driven_bend import bend
from driving_runs import WOTE as CONFIG
from numpy.typing import NDArray
from training_runs import changed_since, copied_weights

from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.errors import LogError
from anchorflow_driving.log import open_logs, read_log, write_log
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes
from anchorflow_models.wote import RewardWeights, WoTE
from anchorflow_training.batches import MirroredBatchConfig
from anchorflow_training.checkpoint import CheckpointError, load_checkpoint, restore_model
from anchorflow_training.config import HeldOutConfig
from anchorflow_training.driving import sensor_windows, wote_run
from anchorflow_training.driving.anchors import anchor_scores, examples_of, pdms, trajectory_anchors
from anchorflow_training.driving.sensor_windows import SensorSizes, open_sensor_windows
from anchorflow_training.driving.wote_run import WoteRun
from anchorflow_training.settings import ConfigError

MODEL = CONFIG.model
SIZES = SensorSizes(16, 32, 32, 32.0)
TOLD = partial(drawn, agents=MODEL.agents)


@pytest.fixture
def logs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.setattr(sensor_windows, "sensed", TOLD)
    return [*open_logs(folder)]


def test_windows_come_back_as_they_were_drawn(logs: list[Path]) -> None:
    windows = open_sensor_windows(logs, SIZES, draw=TOLD)
    assert len(windows) == sum(len(Scenes(read_log(log))) for log in logs)
    per_log = len(windows) // 2
    batch = windows.batch(np.array([2, per_log + 1]))
    assert batch["camera"].shape == (2, 3, 16, 32)
    assert [camera.max() for camera in batch["camera"]] == [2, 1]
    assert (batch["lidar"].dtype, float(batch["lidar"][0].max())) == (np.float32, np.float32(0.4))
    wanted = Scenes(read_log(logs[1]))[1].recorded(np.arange(1, 9) / 2)
    np.testing.assert_allclose(batch["future"][1], wanted, atol=1e-5)


def test_what_is_kept_is_drawn_again_for_other_sizes(logs: list[Path]) -> None:
    kept = [log.with_suffix(sensor_windows.KEPT) for log in logs]
    open_sensor_windows(logs, SIZES, draw=TOLD)
    before = [path.stat().st_mtime_ns for path in kept]
    open_sensor_windows(logs, SIZES, draw=TOLD)
    assert [path.stat().st_mtime_ns for path in kept] == before
    other = open_sensor_windows(logs, replace(SIZES, camera_rows=8), draw=TOLD)
    assert other.batch(np.array([0]))["camera"].shape == (1, 3, 8, 32)


def test_a_log_that_was_cut_off_is_named(logs: list[Path], tmp_path: Path) -> None:
    """The process that reads it names it."""
    log = tmp_path / "cut.npz"
    log.write_bytes(logs[0].read_bytes()[:-100])
    with pytest.raises(LogError, match=r"cut\.npz: file: expected an \.npz of arrays"):
        open_sensor_windows([logs[0], log], SIZES)


def test_what_is_kept_is_read_once_and_closed(
    logs: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    open_sensor_windows(logs, SIZES)
    reads: list[str] = []
    read = np.lib.npyio.NpzFile.__getitem__

    def noted(file: np.lib.npyio.NpzFile, name: str) -> NDArray:
        reads.append(name)
        return read(file, name)

    monkeypatch.setattr(np.lib.npyio.NpzFile, "__getitem__", noted)
    before = len([*Path("/proc/self/fd").iterdir()])
    windows = open_sensor_windows(logs, SIZES)
    assert len(windows) > len(logs) == reads.count("pictures")
    assert len([*Path("/proc/self/fd").iterdir()]) == before


def test_an_earlier_sweep_is_kept_beside_and_now_and_then_lost(
    logs: list[Path], tmp_path: Path
) -> None:
    model = replace(MODEL, backbone=replace(MODEL.backbone, lidar_before=True))
    config = replace(CONFIG, model=model, lidar_before_lost=0.5, steps=1)
    run = WoteRun(config, logs, tmp_path)
    batch = run.windows.batch(np.array([2]), mirrored=True)
    assert float(batch["lidar_before"].max()) == np.float32(0.4)
    told = ["lidar_before" in each for each in run.stream(range(20))]
    assert 4 < sum(told) < 16
    assert told == ["lidar_before" in each for each in run.stream(range(20))]
    run.fit()
    plain = open_sensor_windows(logs, SIZES, draw=TOLD)
    assert "lidar_before" not in plain.batch(np.array([0]))


def test_scores_are_the_scorers_and_are_kept(logs: list[Path]) -> None:
    anchors = trajectory_anchors(examples_of(logs), count=5, seed=0)
    told: list[int] = []
    table = anchor_scores(logs, anchors, progress=lambda done, _: told.append(done))
    again = anchor_scores(logs, anchors, progress=lambda done, _: told.append(done))
    np.testing.assert_array_equal(table, again)
    assert told == [0, 1, 2, 2]
    window = Scenes(read_log(logs[0]))[1]
    wanted = PdmScorer(window).score(anchors.astype(float))
    np.testing.assert_allclose(pdms(table[1]), wanted.pdms, atol=2e-3)  # kept in half precision
    np.testing.assert_allclose(table[1, :, 2], wanted.ep, atol=1e-3)


def test_rewards_are_read_from_a_folder_of_tables(logs: list[Path], tmp_path: Path) -> None:
    shape, rng = (MODEL.anchors, 5), np.random.default_rng(0)
    counts = [len(Scenes(read_log(log))) for log in logs]
    tables = [rng.random((count, *shape), np.float32) for count in counts]
    for log, table in zip(logs, tables, strict=True):
        np.save(tmp_path / f"{log.stem}.npy", table)
    plain = replace(CONFIG, rewards=str(tmp_path), batch=replace(CONFIG.batch, mirror=False))
    run = WoteRun(plain, logs, tmp_path / "run")
    np.testing.assert_array_equal(run.pdm, np.concatenate(tables))
    run.fit()
    with pytest.raises(ConfigError, match=r"rewards: .*\.mirrored\.npy: .*No such file"):
        WoteRun(replace(plain, batch=CONFIG.batch), logs, tmp_path / "mirrored").fit()
    np.save(tmp_path / f"{logs[0].stem}.npy", 2 * tables[0])
    with pytest.raises(ConfigError, match="expected 0 to 1, got"):
        _ = WoteRun(plain, logs, tmp_path / "other").pdm
    brief = replace(plain, model=replace(MODEL, num_steps=6))
    with pytest.raises(ConfigError, match=r"model\.num_steps: expected 8, for the PDM score with"):
        WoteRun(brief, logs, tmp_path / "judged")
    np.save(tmp_path / f"{logs[0].stem}.npy", tables[0])
    run = WoteRun(replace(brief, evaluation=HeldOutConfig()), logs, tmp_path / "brief")
    run.fit()  # six poses, which no PDM score knows
    assert run.model.anchors.shape == (MODEL.anchors, 6, 3)
    moved = replace(plain, objective=replace(plain.objective, moved=True))
    with pytest.raises(ConfigError, match="rewards: expected none with"):
        WoteRun(moved, logs, tmp_path / "moved")


def test_rewards_are_read_by_the_tokens_of_frames(logs: list[Path], tmp_path: Path) -> None:
    """As the authors' tables have them, which know nothing of windows and their order."""
    told, rng, file = [], np.random.default_rng(0), tmp_path / "rewards.npz"
    for path in logs:
        log = read_log(path)
        tokens = np.array([f"{path.stem} {frame}" for frame in range(log.frames)])
        write_log(replace(log, frame_token=tokens), tmp_path / path.name)
        told += tokens[log.window_frame].tolist()
    shape = (MODEL.anchors, 5)
    table: dict[str, Any] = {token: rng.random(shape, np.float32) for token in sorted(told)[::-1]}
    np.savez(file, **table)
    plain = replace(CONFIG, rewards=str(file), batch=replace(CONFIG.batch, mirror=False))
    own = [tmp_path / path.name for path in logs]
    run = WoteRun(plain, own, tmp_path / "run")
    np.testing.assert_array_equal(run.pdm, [table[token] for token in told])
    with pytest.raises(ConfigError, match=r"rewards: .* an array 'bend-0 20\.mirrored', got none"):
        _ = run.mirrored_pdm
    for wrong, said in ((table[told[0]][:-1], r"got \[\d+, 5\]"), (2 + table[told[0]], "got 2")):
        np.savez(file, **{**table, told[0]: wrong})
        with pytest.raises(ConfigError, match=rf"{told[0]}: expected \[\d+, 5\] of 0 to 1, {said}"):
            _ = WoteRun(plain, own, tmp_path / "wrong").pdm
    with pytest.raises(ConfigError, match=r"logs with tokens of their frames, .*, got .* without"):
        _ = WoteRun(plain, logs, tmp_path / "untold").pdm
    file.write_bytes(b"no table")
    with pytest.raises(ConfigError, match=rf"rewards: {file}: "):
        _ = WoteRun(plain, own, tmp_path / "damaged").pdm


def test_half_of_the_batches_are_reflected(logs: list[Path], tmp_path: Path) -> None:
    def futures(*, mirror: bool) -> list[NDArray[np.float32]]:
        config = replace(CONFIG, batch=MirroredBatchConfig(scenes=2, mirror=mirror))
        return [batch["future"] for batch in WoteRun(config, logs, tmp_path).stream(range(12))]

    signs = [
        float(np.sign(other[..., 1].sum() * own[..., 1].sum()))
        for own, other in zip(futures(mirror=False), futures(mirror=True), strict=True)
    ]
    assert set(signs) == {-1.0, 1.0}


def test_anchors_in_a_reflected_window_are_worth_what_they_are_in_that_of_the_mirrored_bend(
    logs: list[Path], tmp_path: Path
) -> None:
    window = Scenes(bend(0, mirrored=True))[0]
    driven = window.recorded(PLAN_TIMES)
    aside = np.linspace(-4.0, 4.0, MODEL.anchors)
    anchors = driven + aside[:, None, None] * [0.0, 1.0, 0.0]
    np.save(tmp_path / "anchors.npy", anchors)
    run = WoteRun(replace(CONFIG, anchors=str(tmp_path / "anchors.npy")), logs, tmp_path)
    batch = run.window_batch(np.array([0]), mirrored=True)
    wanted = PdmScorer(window).score(anchors).sub_scores
    np.testing.assert_allclose(batch["future"][0], driven, atol=1e-4)
    np.testing.assert_allclose(batch["pdm"][0], wanted, atol=2e-3)  # kept in half precision
    assert np.ptp(wanted[:, 1]) == 1
    assert not np.allclose(run.pdm[0], batch["pdm"][0], atol=0.1)


def test_anchors_are_scored_before_several_loaders_ask(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by: list[threading.Thread] = []

    def scored(*args: Any) -> NDArray[np.float32]:
        by.append(threading.current_thread())
        return anchor_scores(*args)

    monkeypatch.setattr(wote_run, "anchor_scores", scored)
    run = WoteRun(replace(CONFIG, loaders=3), logs, tmp_path)
    assert len([*run.stream(range(4))]) == 4
    assert by == [threading.current_thread()] * 2  # the windows, and their reflections


def test_without_an_example_there_are_no_anchors() -> None:
    with pytest.raises(ConfigError, match="anchors: expected examples to cluster, found none"):
        trajectory_anchors(np.zeros((0, 8, 3)), count=4, seed=0)


def test_anchors_are_centres_of_what_was_driven() -> None:
    rng = np.random.default_rng(0)
    kinds = np.zeros((3, 8, 3))
    kinds[:, :, 0] = np.arange(1, 9) * np.array([[1.0], [5.0], [9.0]])
    kinds[2, :, 2] = 0.5
    futures = np.repeat(kinds, 20, axis=0) + rng.normal(0, 0.05, (60, 8, 3))
    anchors = trajectory_anchors(futures, count=3, seed=0)
    np.testing.assert_allclose(anchors, kinds, atol=0.05)


def test_a_run_goes_on_with_other_weights_of_its_rewards(logs: list[Path], tmp_path: Path) -> None:
    """They decide what is chosen and nothing of what is learnt; a network's width is another."""
    WoteRun(replace(CONFIG, steps=1), logs, tmp_path).fit()
    chosen = replace(MODEL, rewards=RewardWeights(im=0.3))
    WoteRun(replace(CONFIG, steps=2, model=chosen), logs, tmp_path).fit()
    restored = restore_model(load_checkpoint(tmp_path / "checkpoint.pt"))
    assert restored.config.rewards.im == 0.3
    with pytest.raises(CheckpointError, match=r"model\.hidden"):
        WoteRun(replace(CONFIG, model=replace(MODEL, hidden=8)), logs, tmp_path)


def test_a_checkpoint_brings_back_its_anchors(logs: list[Path], tmp_path: Path) -> None:
    anchors = trajectory_anchors(examples_of(logs), count=12, seed=3)
    np.save(tmp_path / "anchors.npy", anchors)
    config = replace(CONFIG, steps=1, anchors=str(tmp_path / "anchors.npy"))
    WoteRun(config, logs, tmp_path / "run").fit()
    restored = restore_model(load_checkpoint(tmp_path / "run" / "checkpoint.pt"))
    assert isinstance(restored, WoTE)
    np.testing.assert_array_equal(restored.anchors.numpy(), anchors)


def test_a_run_begins_with_the_perception_of_another(logs: list[Path], tmp_path: Path) -> None:
    first = WoteRun(replace(CONFIG, steps=1), logs, tmp_path / "first")
    first.fit()
    saved = tmp_path / "first" / "checkpoint.pt"
    other = replace(CONFIG, perception=str(saved), model=replace(MODEL, width=MODEL.width * 2))
    run = WoteRun(other, logs, tmp_path / "other")
    wanted = first.averaged_model().backbone.state_dict()
    torch.testing.assert_close(run.model.backbone.state_dict(), wanted)


def test_a_perception_goes_over_the_weights_of_the_run_before(
    logs: list[Path], tmp_path: Path
) -> None:
    saved = []
    for seed in (1, 2):
        config = replace(CONFIG, steps=1, batch=replace(CONFIG.batch, seed=seed))
        WoteRun(config, logs, tmp_path / str(seed)).fit()
        saved.append(tmp_path / str(seed) / "checkpoint.pt")
    config = replace(CONFIG, before=str(saved[0]), perception=str(saved[1]))
    found = WoteRun(config, logs, tmp_path / "both").model.state_dict()
    first, second = (load_checkpoint(path).average for path in saved)
    for name, weight in found.items():
        wanted = second if name.startswith("backbone.") else first
        torch.testing.assert_close(weight, wanted[name])
    for name in ("anchors", "resnet"):
        with pytest.raises(ConfigError, match=f"{name}: expected none beside before.* got mine"):
            WoteRun(replace(config, **{name: "mine"}), logs, tmp_path / name)


def test_a_frozen_perception_stays_as_it_is(logs: list[Path], tmp_path: Path) -> None:
    run = WoteRun(replace(CONFIG, frozen_perception=True), logs, tmp_path)
    assert not any(weight.requires_grad for weight in run.model.backbone.parameters())
    before = copied_weights(run.model)
    run.fit()
    changed = changed_since(before, run.model)
    assert "to_ego.weight" in changed
    assert not [name for name in changed if name.startswith("backbone.")]


def test_what_does_not_fit_is_named(logs: list[Path], tmp_path: Path) -> None:
    all_held_out = replace(CONFIG, evaluation=HeldOutConfig(held_out=99))
    with pytest.raises(
        ConfigError, match=r"evaluation.held_out: expected less than \d+, .* got 99"
    ):
        WoteRun(all_held_out, logs, tmp_path)
    hasty = replace(CONFIG, model=replace(MODEL, dt=0.1))
    with pytest.raises(ConfigError, match=r"model.dt: expected 0.5, as the logs have, got 0.1"):
        WoteRun(hasty, logs, tmp_path)


def test_a_log_without_windows_is_passed_over(logs: list[Path], tmp_path: Path) -> None:
    log, bare = read_log(logs[0]), tmp_path / "bare.npz"
    own = {
        name: array[:0]
        for name, array in vars(log).items()
        if name.startswith(("window_", "route_"))
    }
    write_log(replace(log, **own | {"route_offsets": log.route_offsets[:1]}), bare)
    windows = open_sensor_windows([bare, logs[1]], SIZES, draw=TOLD)
    assert set(windows.log) == {1}
    with pytest.raises(LogError, match="expected windows, found none in any log"):
        open_sensor_windows([bare], SIZES, draw=TOLD)
