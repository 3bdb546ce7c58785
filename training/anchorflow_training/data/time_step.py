"""How far apart in time the steps of a file's trajectories lie."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from anchorflow_training.data.array_source import ArraySource, read_whole
from anchorflow_training.dataset import DatasetError

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
) -> float | None:
    """The time step [s]: the caller's, else what the file's dt, horizon_s or times imply.

    None where nothing implies one and the file brings its own derivatives.

    Raises:
        DatasetError: a time is not above 0, times are uneven, or two statements disagree.
        TimeStepUnknown: nothing implies a time step, and there are derivatives to take.
    """
    implied: dict[str, float] = {}
    if dt is None and horizon_s is None:
        dt, horizon_s = (_one_value(path, name, arrays) for name in ("dt", "horizon_s"))
        if "times" in arrays:
            implied["times"] = _even_step(path, arrays["times"])
    for name, value, steps in (("dt", dt, 1), ("horizon_s", horizon_s, num_steps - 1)):
        if value is not None and not 0 < value < np.inf:
            raise DatasetError(f"{path}: {name}: expected seconds above 0, found {value}")
        if value is not None:
            implied[name] = value / steps
    if any(not np.isclose(step, min(implied.values()), AGREED) for step in implied.values()):
        raise DatasetError(
            f"{path}: expected one time step, horizon_s = dt (T - 1), found "
            + ", ".join(f"{step:g} s from {name}" for name, step in implied.items())
        )
    if not implied and not {"velocities", "accelerations"} <= set(arrays):
        raise TimeStepUnknown(
            f"{path}: dt: expected the time step, or horizon_s or times that imply it, in s "
            "(--dt, --horizon-s), to differentiate the positions by, found none of them"
        )
    return next(iter(implied.values()), None)


def _one_value(path: Path, name: str, arrays: Mapping[str, ArraySource]) -> float | None:
    """What all samples share, whether the file says it once or for each of them."""
    if name not in arrays:
        return None
    values = np.atleast_1d(read_whole(arrays[name]))
    if (values != values[0]).any():
        raise DatasetError(
            f"{path}: {name}: expected one value for all samples, "
            f"found {values.min():g} to {values.max():g} s"
        )
    return float(values[0])


def _even_step(path: Path, times: ArraySource) -> float:
    """The mean step of times [T] that are evenly spaced."""
    steps = np.diff(read_whole(times).astype(np.float64))
    if not (steps > 0).all() or np.ptp(steps) > EVEN * steps.mean():
        raise DatasetError(
            f"{path}: times: expected rising seconds, evenly spaced, "
            f"found steps of {steps.min():g} to {steps.max():g} s"
        )
    return float(steps.mean())
