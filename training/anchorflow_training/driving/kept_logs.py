"""What all training on driving logs shares: the logs of a folder, and what is kept beside them."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.errors import UNREADABLE, LogError
from anchorflow_training.whole_file import whole_file
from anchorflow_trajectory.cores import usable_cores

PLAN_SETTINGS: Mapping[str, Any] = {"num_steps": len(PLAN_TIMES), "dt": float(PLAN_TIMES[0])}
"""What the times of a log's plans fix of a model's configuration."""

DIGITS = 12  # of a digest in a kept file's name
Progress = Callable[[int, int], None]
"""Told how many of how many logs are done."""


def open_logs(folder: Path) -> Sequence[Path]:
    """The logs of a folder. Raises `LogError` where there are none."""
    logs = sorted(folder.glob("*.npz"))
    if not logs:
        raise LogError(folder, "folder", expected="logs (*.npz)", found="none")
    return logs


def no_windows(folder: Path) -> LogError:
    """None of the logs has a window to learn from."""
    return LogError(folder, "window_ego", expected="windows", found="none in any log")


def each_log(
    keep: Callable[[Path], None],
    logs: Sequence[Path],
    *,
    of: int,
    progress: Progress = lambda *_: None,
) -> None:
    """Do something with each log, on each usable core; what is done stays done if it is cut off."""
    progress(of - len(logs), of)
    if not logs:
        return
    with ProcessPoolExecutor(min(len(logs), usable_cores())) as pool:
        for done, _ in enumerate(pool.map(keep, logs), start=of - len(logs) + 1):
            progress(done, of)


def is_fresh(kept: Path, log: Path) -> bool:
    """Whether a file is there, whole, and was made of the log as it is."""
    if not kept.exists() or kept.stat().st_mtime < log.stat().st_mtime:
        return False
    try:
        zipfile.ZipFile(kept).close()  # its directory stands at its end
    except UNREADABLE:
        return False
    return True


@contextmanager
def opened(kept: Path) -> Iterator[Mapping[str, NDArray[Any]]]:
    """The arrays of a file beside a log, to be read in the block.

    Raises:
        LogError: it is damaged.
    """
    try:
        with np.load(kept, allow_pickle=False) as arrays:
            yield arrays
    except (*UNREADABLE, KeyError) as error:  # KeyError: the damage is in an array's name
        wanted = "an .npz of arrays, which is made anew where there is none"
        raise LogError(kept, "file", expected=wanted, found=str(error)) from error


def write_beside(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays whole or not at all; raises `LogError` where there is no place to write."""
    try:
        with whole_file(path) as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
    except OSError as error:
        raise LogError(path, "file", expected="a place to write", found=str(error)) from error
