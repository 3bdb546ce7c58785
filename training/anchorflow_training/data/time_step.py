"""How far apart in time the steps of a file's trajectories lie, alike in all or each by itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.data.array_source import ArraySource, read_whole
from anchorflow_training.dataset import DatasetError

Seconds = float | NDArray[np.float64]
"""One number for all samples, or [N]."""

EVEN = 1e-3  # share by which one step of recorded times may differ from their mean step
AGREED = 1e-4  # share by which two statements of the time step may differ


class TimeStepUnknown(DatasetError):
    """Derivatives are to be taken, and nothing says how far apart in time two steps lie."""


def time_step(
    path: Path,
    arrays: Mapping[str, ArraySource],
    *,
    num_steps: int,
    dt: float | None = None,
    horizon_s: float | None = None,
) -> Seconds | None:
    """The time step [s]: the caller's, else what the file's dt, horizon_s or times imply.

    One number where all samples share it, else [N]; None where nothing implies one and the file
    brings its own derivatives.

    Raises:
        DatasetError: a time is not above 0, times are uneven, or two statements disagree.
        TimeStepUnknown: nothing implies a time step, and there are derivatives to take.
    """
    implied: dict[str, Seconds] = {}
    told: dict[str, Seconds | None] = {"dt": dt, "horizon_s": horizon_s}
    if dt is None and horizon_s is None:
        told = {name: _seconds(name, arrays) for name in told}
        if "times" in arrays:
            implied["times"] = _even_step(path, arrays["times"])
    for (name, value), count in zip(told.items(), (1, num_steps - 1), strict=True):
        if value is not None:
            _check_seconds(path, name, value)
            implied[name] = value / count
    steps = list(implied.values())
    if any(not np.allclose(step, steps[0], AGREED, 0.0) for step in steps):
        raise DatasetError(
            f"{path}: expected one time step, horizon_s = dt (T - 1), found "
            + ", ".join(f"{in_words(step)} from {name}" for name, step in implied.items())
        )
    if not implied and not {"velocities", "accelerations"} <= set(arrays):
        raise TimeStepUnknown(
            f"{path}: dt: expected the time step, or horizon_s or times that imply it, in s "
            "(--dt, --horizon-s), to differentiate the positions by, found none of them"
        )
    # Who is told each sample's knows more than who is told one for all.
    return max(steps, key=np.size, default=None)


def in_words(seconds: Seconds) -> str:
    """What a person reads: 0.1 s, or 0.1 to 0.3 s."""
    least, most = np.min(seconds), np.max(seconds)
    return f"{least:g} s" if least == most else f"{least:g} to {most:g} s"


def _seconds(name: str, arrays: Mapping[str, ArraySource]) -> Seconds | None:
    """One number where all samples share it, whether the file says it once or for each of them."""
    if name not in arrays:
        return None
    values = np.atleast_1d(read_whole(arrays[name])).astype(np.float64)
    return float(values[0]) if (values == values[0]).all() else values


def _check_seconds(path: Path, name: str, value: Seconds) -> None:
    values = np.atleast_1d(value)
    wrong = np.flatnonzero(~((values > 0) & (values < np.inf)))
    if len(wrong):
        where = "" if len(values) == 1 else f" in row {wrong[0]}"
        raise DatasetError(
            f"{path}: {name}: expected seconds above 0, found {values[wrong[0]]}{where}"
        )


def _even_step(path: Path, times: ArraySource) -> float:
    """The mean step of times [T] that are evenly spaced."""
    steps = np.diff(read_whole(times).astype(np.float64))
    if not (steps > 0).all() or np.ptp(steps) > EVEN * steps.mean():
        raise DatasetError(
            f"{path}: times: expected rising seconds, evenly spaced, "
            f"found steps of {steps.min():g} to {steps.max():g} s"
        )
    return float(steps.mean())
