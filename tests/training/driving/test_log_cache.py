"""The cache of arrays beside logs, and the PDM judge of their windows."""

from __future__ import annotations

import multiprocessing
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from driven_bend import write_bends

from anchorflow_driving.log import read_log
from anchorflow_driving.pdm import PdmScorer, direction_compliance
from anchorflow_driving.window import Scenes
from anchorflow_training.driving.log_cache import log_arrays, open_logs
from anchorflow_training.driving.pdm_judge import PdmJudge


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


T = 8


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return [*open_logs(write_bends(tmp_path_factory.mktemp("bends"), count=2))]


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
    for processes in (1, 3):
        judge = PdmJudge(logs, of_log, direction=True, processes=processes)
        torch.testing.assert_close(judge(*asked, speeds), wanted, rtol=0, atol=0)
