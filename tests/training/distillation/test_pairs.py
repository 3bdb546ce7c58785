"""The pairs on disk are the teacher's solutions, also after an interruption."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from anchorflow_client.contract import uniform_schedule
from anchorflow_training.batches import FlowBatchConfig, dealt_routes, encode_inputs, prior_means
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.objective import PAIRED, NormalisedFlow, drawn, start_states
from anchorflow_training.distillation.pairs import (
    PairBank,
    PairBatches,
    TeacherConfig,
    make_pairs,
    open_pairs,
)
from anchorflow_training.distillation.teacher import Teacher
from anchorflow_training.settings import ConfigError
from anchorflow_trajectory.ode.methods import HEUN

CONFIG = TeacherConfig(method="heun", steps=3, pairs=4, seed=9)


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six scenes make two blocks, the second of two scenes."""
    monkeypatch.setattr("anchorflow_training.distillation.pairs.BLOCK", 4)


def make(
    path: Path, teacher: Teacher, dataset: SceneDataset, *, blocks: list[int] | None = None
) -> PairBank:
    bank = open_pairs(path, teacher, dataset, CONFIG)
    bank.begin()
    asked = bank.missing() if blocks is None else blocks
    make_pairs(bank, asked, teacher=teacher, dataset=dataset, config=CONFIG)
    return bank


def test_a_pair_is_what_the_teacher_s_solver_makes_of_the_noise(
    teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    bank = make(tmp_path, teacher, tiny_dataset)
    for scene in (0, 5):  # one of each block
        batch = tiny_dataset.batch(np.array([scene]))
        inputs = {name: torch.from_numpy(array) for name, array in encode_inputs(batch).items()}
        mean = torch.from_numpy(prior_means(batch, dealt_routes(batch, CONFIG.pairs)))
        noise = torch.from_numpy(bank.noise(scene))[None]
        schedule = uniform_schedule(CONFIG.steps)
        expected = drawn(teacher.model, inputs, noise, mean, schedule=schedule, method=HEUN)
        flow = NormalisedFlow.of(teacher.model, inputs, mean)
        got = torch.from_numpy(bank.ends(scene))[None]
        torch.testing.assert_close(  # half precision
            got, flow.normalised(expected), rtol=2e-3, atol=2e-3
        )
    assert not np.array_equal(bank.noise(0), bank.noise(5))


def test_pairs_are_made_once_and_only_where_they_are_missing(
    teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    whole = make(tmp_path / "whole", teacher, tiny_dataset)
    cut = make(tmp_path / "cut", teacher, tiny_dataset, blocks=[1])
    (tmp_path / "cut" / "00000.npy.1").write_bytes(b"half a file")
    assert cut.missing() == [0]
    written = cut.file(1).stat().st_mtime_ns
    again = make(tmp_path / "cut", teacher, tiny_dataset)
    assert again.missing() == []
    assert again.file(1).stat().st_mtime_ns == written
    for block in range(2):
        assert again.file(block).read_bytes() == whole.file(block).read_bytes()


@pytest.mark.parametrize("name", ["pairs.json", "00000.npy", "00001.npy"])
def test_a_full_disk_is_named_and_with_more_room_it_goes_on(
    name: str, teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    draft = tmp_path / f"{name}.{os.getpid()}"
    draft.symlink_to("/dev/full")
    with pytest.raises(
        ConfigError, match=rf"{tmp_path / name}: expected a place to write \(.*No space"
    ):
        make(tmp_path, teacher, tiny_dataset)
    assert not (tmp_path / name).exists()
    assert not draft.is_symlink()
    bank = make(tmp_path, teacher, tiny_dataset)
    assert bank.missing() == []
    assert np.isfinite(bank.ends(5)).all()


@pytest.mark.parametrize("kept", [0, 40, -1])
def test_a_block_that_was_cut_off_is_made_anew(
    kept: int, teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    block = make(tmp_path, teacher, tiny_dataset).file(0)
    whole = block.read_bytes()
    block.write_bytes(whole[:kept])
    bank = make(tmp_path, teacher, tiny_dataset)
    assert block.read_bytes() == whole
    assert np.isfinite(bank.ends(0)).all()
    block.write_bytes(bank.file(1).read_bytes())  # of fewer scenes
    assert bank.missing() == [0]


@pytest.mark.parametrize("content", ["", "[]", '{"format": 1'])
def test_a_description_that_is_none_is_named(
    content: str, teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    (tmp_path / "pairs.json").write_text(content)
    with pytest.raises(ConfigError, match=r"pairs\.json: .*[Ee]xpect"):
        open_pairs(tmp_path, teacher, tiny_dataset, CONFIG)


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"method": "rk4"}, "method"),
        ({"steps": 4}, "steps"),
        ({"pairs": 5}, "pairs"),
        ({"seed": 1}, "seed"),
        ({"noise_scale": 1.2}, "noise_scale"),
        ({"scenes": 5}, "dataset"),
    ],
)
def test_other_pairs_are_refused_by_name(
    changed: dict[str, Any],
    name: str,
    teacher: Teacher,
    tiny_dataset: SceneDataset,
    tmp_path: Path,
) -> None:
    open_pairs(tmp_path, teacher, tiny_dataset, CONFIG).begin()
    with pytest.raises(ConfigError, match=rf"pairs\.json: {name}: expected .*, found "):
        open_pairs(tmp_path, teacher, tiny_dataset, replace(CONFIG, **changed))


def test_another_teacher_s_pairs_are_refused(
    teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    open_pairs(tmp_path, teacher, tiny_dataset, CONFIG).begin()
    with pytest.raises(ConfigError, match=r"teacher: expected 666.*, found 555"):
        open_pairs(tmp_path, replace(teacher, sha256="6" * 64), tiny_dataset, CONFIG)


def test_a_batch_depends_on_seed_and_number_alone_and_takes_every_pair(
    teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    bank = make(tmp_path, teacher, tiny_dataset)
    starts = start_states(teacher.model).numpy()
    config = FlowBatchConfig(scenes=2, samples=4, mirror=False)
    batches = PairBatches(tiny_dataset, bank, starts, config)
    first, again, other = batches.draw(3), batches.draw(3), batches.draw(4)
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])
    assert not np.array_equal(first["z_1"], other["z_1"])
    ends = {scene: bank.ends(scene) for scene in range(6)}
    for got in first["z_1"]:
        assert any(np.array_equal(np.sort(got, 0), np.sort(end, 0)) for end in ends.values())


def test_a_reflected_batch_is_the_reflection_of_the_same_pairs(
    teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    bank = make(tmp_path, teacher, tiny_dataset)
    starts = start_states(teacher.model).numpy()
    plain, reflecting = (
        PairBatches(tiny_dataset, bank, starts, FlowBatchConfig(scenes=2, samples=4, mirror=mirror))
        for mirror in (False, True)
    )
    kinds = set()
    for index in range(8):
        upright, other = (each.draw(index) for each in (plain, reflecting))
        mirrored = not np.array_equal(upright["x_curr"], other["x_curr"])
        kinds.add(mirrored)
        sign = np.append(np.tile([1.0, -1.0 if mirrored else 1.0], 3), 1.0)
        for name in ("z_0", "z_1"):
            x, x_m = (in_si(teacher, batch, name) for batch in (upright, other))
            np.testing.assert_allclose(x_m, x * sign, rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(other["reference_s"], upright["reference_s"], rtol=1e-5)
    assert kinds == {True, False}


@torch.no_grad()
def in_si(teacher: Teacher, batch: dict[str, Any], name: str) -> np.ndarray:
    arrays = {key: torch.from_numpy(value) for key, value in batch.items()}
    paired = {key: arrays.pop(key) for key in PAIRED}
    flow = NormalisedFlow.of(teacher.model, arrays, paired["prior_mean"])
    return flow.in_si(paired[name]).numpy()
