"""Names, shapes and time step of the arrays of a trajectory file; see docs/training-data.md.

Files of other tools say the same in other words, which `ALIASES` lists.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.fields import MAX_CHANNELS, MAX_MAP_CELLS, MIN_MAP_CELLS
from anchorflow_training.data.file_formats import ArraySource, read_whole
from anchorflow_training.dataset import DatasetError

SAMPLE_ARRAYS = (
    "positions",
    "velocities",
    "accelerations",
    "cost_maps",
    "start_states",
    "goal_states",
    "style_weights",
    "safety_margins",
    "quality",
)
GEOMETRY_ARRAYS = ("resolution", "origin")  # one for all samples, or one each
TIME_ARRAYS = ("dt", "horizon_s", "times")
KNOWN_ARRAYS = (*SAMPLE_ARRAYS, *GEOMETRY_ARRAYS, *TIME_ARRAYS)
ALIASES = {
    "trajectories": "positions",
    "trajectory_quality": "quality",
    "horizon": "horizon_s",
}

LEAST_STEPS = 3  # a second difference needs three points


def by_own_names(path: Path, arrays: Mapping[str, ArraySource]) -> dict[str, ArraySource]:
    """The arrays under the names above; raises `DatasetError` where one comes under two names."""
    both = [f"{name} or {alias}" for alias, name in ALIASES.items() if {alias, name} <= set(arrays)]
    if both:
        raise DatasetError(f"{path}: expected {both[0]}, found both")
    return {ALIASES.get(name, name): array for name, array in arrays.items()}


def check_layout(path: Path, arrays: Mapping[str, ArraySource]) -> None:
    """Raises `DatasetError` naming the first array that is missing or has another shape."""
    if "positions" not in arrays:
        raise DatasetError(
            f"{path}: positions: expected an array [N, T, D] of this name, or trajectories, found "
            + (f"only {', '.join(sorted(arrays))}" if arrays else "no array")
        )
    found = arrays["positions"].shape
    if len(found) != 3 or found[0] < 1 or found[1] < LEAST_STEPS or found[2] not in (2, 3):
        raise _wrong_shape(
            path, "positions", f"[N, T, D] with N >= 1, T >= {LEAST_STEPS}, D 2 or 3", found
        )
    count, _, dim = found
    expected = {
        "velocities": [found],
        "accelerations": [found],
        "start_states": [(count, 3 * dim)],
        "goal_states": [(count, 2 * dim)],
        "style_weights": [(count, 3)],
        "safety_margins": [(count,)],
        "quality": [(count,)],
        "resolution": [(), (count,)],
        "origin": [(2,), (count, 2)],
        "dt": [(), (1,), (count,)],
        "horizon_s": [(), (1,), (count,)],
        "times": [(found[1],)],
    }
    for name, shapes in expected.items():
        if name in arrays and arrays[name].shape not in shapes:
            choice = " or ".join(str(list(shape)) for shape in shapes)
            raise _wrong_shape(
                path, name, f"{choice} beside positions {list(found)}", arrays[name].shape
            )
    _check_maps(path, arrays, count)
    for name in KNOWN_ARRAYS:
        if name in arrays and arrays[name].dtype.kind not in "fiub":
            raise DatasetError(f"{path}: {name}: expected numbers, found {arrays[name].dtype}")


def _check_maps(path: Path, arrays: Mapping[str, ArraySource], count: int) -> None:
    if "cost_maps" not in arrays:
        return
    shape = arrays["cost_maps"].shape
    sides = all(MIN_MAP_CELLS <= side <= MAX_MAP_CELLS for side in shape[-2:])
    if len(shape) != 4 or shape[0] != count or not 1 <= shape[1] <= MAX_CHANNELS or not sides:
        expected = (
            f"[{count}, C, H, W] with C 1..{MAX_CHANNELS}, H and W {MIN_MAP_CELLS}..{MAX_MAP_CELLS}"
        )
        raise _wrong_shape(path, "cost_maps", expected, shape)


def _wrong_shape(path: Path, name: str, expected: str, found: tuple[int, ...]) -> DatasetError:
    return DatasetError(f"{path}: {name}: expected {expected}, found {list(found)}")


def check_values(path: Path | str, name: str, block: NDArray[Any], first_row: int) -> None:
    """Raises `DatasetError` naming the first row of a block that is out of range.

    block: rows from `first_row` on; those that are not finite are another matter and pass.
    """
    rows = block.reshape(len(block), -1)
    if name == "quality" or (name == "cost_maps" and block.dtype != np.uint8):
        wrong, expected = ((rows < 0) | (rows > 1)).any(1), "in [0, 1]"
    elif name in ("safety_margins", "style_weights"):
        wrong, expected = (rows < 0).any(1), "at least 0"
        if name == "style_weights":
            wrong, expected = wrong | (rows.sum(1) == 0), "at least 0 and not all 0"
    elif name == "resolution":
        wrong, expected = (rows <= 0).any(1), "more than 0"
    else:
        return
    if wrong.any():
        row = int(np.argmax(wrong))
        found = f"{rows[row].min():g} to {rows[row].max():g}"
        raise DatasetError(
            f"{path}: {name}: expected values {expected}, found {found} in row {first_row + row}"
        )


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

    Raises `DatasetError` if a time is not above 0, times are uneven, or two statements disagree;
    `TimeStepUnknown` if nothing implies a time step, and there are derivatives to take.
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
    # One time step a sample says more than one for all.
    return max(steps, key=np.size, default=None)


def in_words(seconds: Seconds) -> str:
    """Return "0.1 s", or "0.1 to 0.3 s"."""
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
