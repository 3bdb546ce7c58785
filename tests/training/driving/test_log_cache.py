"""Something is done with every log, on the cores that this process may use."""

from __future__ import annotations

import multiprocessing
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from anchorflow_training.driving.log_cache import log_arrays


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
