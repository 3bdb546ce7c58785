"""The driving logs of a folder, and arrays that are made of each log once and cached beside it."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.errors import UNREADABLE, LogError, place_to_write
from anchorflow_training.atomic_write import atomic_write
from anchorflow_training.settings import ConfigError
from anchorflow_trajectory.threads import usable_cores

PLAN_SETTINGS: Mapping[str, Any] = {"dt": float(PLAN_TIMES[0])}
"""The settings of a model's configuration that the times of a log's plans require."""

Arrays = Mapping[str, NDArray[Any]]
Progress = Callable[[int, int], None]
"""Called with the number of logs that are done, and of all."""


def check_horizon(num_steps: int, *, whole: str | None) -> None:
    """Raise `ConfigError` for more poses than logs' plans have, or fewer if all are needed.

    whole: what needs all of them, if anything does
    """
    most = len(PLAN_TIMES)
    if num_steps > most or (whole and num_steps < most):
        expected = f"{most}, for {whole}" if whole else f"at most {most}, as the logs have"
        raise ConfigError(f"model.num_steps: expected {expected}, got {num_steps}")


def no_windows(folder: Path) -> LogError:
    """Return the error for logs without a window to learn from."""
    return LogError(folder, "window_ego", expected="windows", found="none in any log")


def digest(*parts: Any) -> str:
    """Return 12 digits for the suffix of a cache file: of arrays, or of other values' text."""
    hashed = hashlib.sha256()
    for part in parts:
        is_array = isinstance(part, np.ndarray)
        hashed.update(np.ascontiguousarray(part).data if is_array else repr(part).encode())
    return hashed.hexdigest()[:12]


def log_arrays(
    logs: Sequence[Path],
    suffix: str,
    make: Callable[[Path], Arrays],
    *,
    is_current: Callable[[Arrays], bool] = lambda _: True,
    progress: Progress = lambda *_: None,
) -> Iterator[Arrays]:
    """Yield the arrays of each log, made on every usable core if the log has no current cache.

    suffix: of the cache files; make: the arrays of a log, a function that can be pickled
    is_current: whether cached arrays are still those that `make` would return

    Raises `LogError` if a log or its cache cannot be read, or there is no place to write beside it.
    """
    missing = [log for log in logs if not _is_cached(log, log.with_suffix(suffix), is_current)]
    done = len(logs) - len(missing)
    progress(done, len(logs))
    if missing:
        with ProcessPoolExecutor(min(len(missing), usable_cores())) as pool:
            work = partial(_cache, suffix=suffix, make=make)
            for count, _ in enumerate(pool.map(work, missing), start=done + 1):
                progress(count, len(logs))
    for log in logs:
        yield _read(log.with_suffix(suffix), dict)


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write an .npz whole or not at all; raise `LogError` if there is no place to write."""
    with place_to_write(path), atomic_write(path) as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _cache(log: Path, *, suffix: str, make: Callable[[Path], Arrays]) -> None:
    write_arrays(log.with_suffix(suffix), make(log))


def _is_cached(log: Path, file: Path, is_current: Callable[[Arrays], bool]) -> bool:
    if not file.exists() or file.stat().st_mtime < log.stat().st_mtime:
        return False
    try:
        zipfile.ZipFile(file).close()  # its directory is at its end, so it was written whole
    except UNREADABLE:
        return False
    return _read(file, is_current)


def _read(file: Path, use: Callable[[Arrays], Any]) -> Any:
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return use(arrays)
    except (*UNREADABLE, KeyError) as error:  # KeyError: the damage is in an array's name
        wanted = "an .npz of arrays, which is made anew where there is none"
        raise LogError(file, "file", expected=wanted, found=str(error)) from error
