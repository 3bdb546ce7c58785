"""The cache of arrays beside logs, and the PDM judge of their windows."""

from __future__ import annotations

import multiprocessing
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from anchorflow_driving.errors import LogError
from anchorflow_driving.log import open_logs, read_log
from anchorflow_driving.pdm import PdmScorer, direction_compliance
from anchorflow_driving.window import Scenes
from anchorflow_training.driving.log_cache import log_arrays, write_arrays
from anchorflow_training.driving.pdm_judge import PdmJudge


@pytest.fixture(scope="module")
def logs(folder: Path) -> list[Path]:
    return [*open_logs(folder)]


def numbered(log: Path) -> dict[str, np.ndarray]:
    return {"number": np.array(int(log.stem))}


@pytest.mark.skipif(sys.platform != "linux", reason="processes are held to cores on Linux alone")
def test_a_process_that_may_use_one_core_has_one_worker(tmp_path: Path) -> None:
    logs = [tmp_path / f"{number}.npz" for number in range(8)]
    for log in logs:
        log.touch()
    workers: list[int] = []
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        made = [
            *log_arrays(
                logs,
                ".made",
                numbered,
                progress=lambda *_: workers.append(len(multiprocessing.active_children())),
            )
        ]
    finally:
        os.sched_setaffinity(0, allowed)
    assert [int(part["number"]) for part in made] == [*range(8)]
    assert max(workers) == 1


def named(log: Path) -> dict[str, np.ndarray]:
    return {"zeros": np.zeros(100), "name": np.frombuffer(log.stem.encode(), np.uint8)}


def kept_beside(logs: list[Path]) -> list[Path]:
    """Make what is missing; return the files."""
    assert len([*log_arrays(logs, ".made", named)]) == len(logs)
    return [log.with_suffix(".made") for log in logs]


def test_arrays_are_made_once_and_again_where_the_log_is_newer(logs: list[Path]) -> None:
    before = [path.stat().st_mtime_ns for path in kept_beside(logs)]
    newer = before[1] / 1e9 + 5
    os.utime(logs[1], (newer, newer))
    told: list[tuple[int, int]] = []
    made = log_arrays(logs, ".made", named, progress=lambda *done: told.append(done))
    assert [bytes(arrays["name"]).decode() for arrays in made] == [log.stem for log in logs]
    assert told == [(1, 2), (2, 2)]
    after = [log.with_suffix(".made").stat().st_mtime_ns for log in logs]
    assert after[0] == before[0]
    assert after[1] > before[1]


def test_what_was_cut_off_is_made_anew_and_what_is_damaged_named(logs: list[Path]) -> None:
    file, whole = kept_beside(logs)[0], kept_beside(logs)[0].read_bytes()
    for cut_off in (b"", b"PK, but cut off", whole[: len(whole) // 2]):
        file.write_bytes(cut_off)
        kept_beside(logs)
        assert len(file.read_bytes()) == len(whole)
    # Damage in an array, and in its name in the directory at the end.
    at_end = whole.rindex(b"zeros.npy")
    for place, found in ((200, "Bad CRC"), (at_end, "header b'zeros.npy' differ")):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(LogError, match=f"{file}: file: expected an .npz .*, found .*{found}"):
            kept_beside(logs)
    file.unlink()
    kept_beside(logs)


class Interrupted:
    """An array whose reader is stopped."""

    def __array__(self, *_: object, **__: object) -> NDArray[np.float64]:
        raise KeyboardInterrupt


def test_what_cannot_be_kept_leaves_no_draft(tmp_path: Path) -> None:
    kept = tmp_path / "a.made"
    write_arrays(kept, {"scores": np.ones(3)})
    draft = tmp_path / f"{kept.name}.{os.getpid()}"
    draft.symlink_to("/dev/full")
    with pytest.raises(LogError, match=f"{kept}: file: expected a place to write, .*No space"):
        write_arrays(kept, {"scores": np.zeros(30_000)})
    with pytest.raises(KeyboardInterrupt):
        write_arrays(kept, {"scores": np.zeros(3), "more": Interrupted()})  # type: ignore[dict-item]
    assert [*tmp_path.iterdir()] == [kept]
    with np.load(kept) as arrays:
        assert arrays["scores"].tolist() == [1, 1, 1]


T = 8


def test_the_judge_is_the_scorer_of_each_window(logs: list[Path]) -> None:
    scenes = [Scenes(read_log(log)) for log in logs]
    of_log = np.repeat([0, 1], [len(each) for each in scenes])
    judge = PdmJudge(logs, of_log)
    last = len(of_log) - 1
    plans = torch.zeros(2, 3, T, 3)
    plans[:, 1, :, 0] = 2.0 * torch.arange(1, 9)
    plans[:, 2, :, 1] = 30.0
    told = judge(torch.tensor([0, last]), plans).numpy()
    for row, window in zip(told, (scenes[0][0], scenes[1][len(scenes[1]) - 1]), strict=True):
        wanted = PdmScorer(window).score(plans[0].numpy())
        np.testing.assert_allclose(row[:, 0], wanted.nc)
        np.testing.assert_allclose(row[:, 2], wanted.ep, atol=1e-6)
        np.testing.assert_allclose(row[:, 4], wanted.c)
    own = scenes[0][0].state.speed
    twice, faster = judge(
        torch.tensor([0, 0]), plans, speeds=torch.tensor([torch.nan, own + 9.0])
    ).numpy()
    np.testing.assert_array_equal(twice, told[0])
    wanted = PdmScorer(scenes[0][0], speed=own + 9.0).score(plans[0].numpy())
    np.testing.assert_allclose(faster[:, 2], wanted.ep, atol=1e-6)
    assert not np.array_equal(faster, twice)
    judge = PdmJudge(logs, of_log, direction=True)
    scorer = PdmScorer(scenes[0][0])
    wanted = direction_compliance(scorer.metres_against(scorer.motion(plans[0].numpy())))
    told = judge(torch.tensor([0]), plans[:1]).numpy()[0]
    np.testing.assert_array_equal(told[:, :5], twice)
    np.testing.assert_allclose(told[:, 5], wanted, atol=1e-6)


def test_processes_judge_as_the_run_itself_does(logs: list[Path]) -> None:
    of_log = np.repeat([0, 1], [len(Scenes(read_log(log))) for log in logs])
    plans = 3.0 * torch.arange(1, 9)[:, None] * torch.tensor([1.0, 0.1, 0.0])
    plans = plans * torch.tensor([0.5, 1.0, 3.0])[:, None, None]
    asked = (torch.tensor([0, 1, len(of_log) - 1]), plans.expand(3, 3, T, 3))
    speeds = torch.tensor([torch.nan, 3.0, torch.nan])
    wanted = PdmJudge(logs, of_log, direction=True)(*asked, speeds)
    assert len(wanted[..., 2].unique()) > 1
    judge = PdmJudge(logs, of_log, direction=True, processes=3)
    torch.testing.assert_close(judge(*asked, speeds), wanted, rtol=0, atol=0)
