"""Summaries of a trajectory file or a scene dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, minimum_position

from anchorflow_client.contract.fields import LIMITS
from anchorflow_training.data.array_layout import in_words
from anchorflow_training.data.statistics import FIELDS
from anchorflow_training.data.trajectory_dataset import TrajectoryDataset
from anchorflow_training.dataset import SceneDataset
from anchorflow_trajectory.motion import MotionLimits

FloatArray = NDArray[np.floating]

EIGHT_NEIGHBOURS = np.ones((3, 3))


def obstacle_points(
    clearance: FloatArray, resolution: float, origin: NDArray[np.floating]
) -> NDArray[np.float64]:
    """A point [2] m inside each obstacle that the robot's centre has to go round, [K, 2].

    clearance: [H, W] m. Obstacles that the robot does not fit between are one.
    """
    obstacles, count = label(clearance < 0, EIGHT_NEIGHBOURS)  # type: ignore[misc]
    if not count:
        return np.empty((0, 2))
    deepest = minimum_position(clearance, obstacles, np.arange(1, count + 1))
    return np.asarray(origin) + (np.asarray(deepest, float)[:, ::-1] + 0.5) * resolution


def homology_classes(positions: FloatArray, points: FloatArray) -> NDArray[np.int64]:
    """A class [M] for each of a scene's trajectories [M, T, D >= 2], from 0 up.

    Two trajectories with common ends are in one class where their loop winds round none of the
    `points` [K, 2]: where both sweep the same angle as seen from each.
    """
    if not len(points):
        return np.zeros(len(positions), np.int64)
    rays = positions[:, None, :, :2] - points[:, None]
    angle = np.arctan2(rays[..., 1], rays[..., 0])
    # A straight piece sweeps less than half a turn.
    steps = (np.diff(angle, axis=-1) + np.pi) % (2 * np.pi) - np.pi
    swept = steps.sum(-1)
    turns = np.rint((swept - swept[:1]) / (2 * np.pi)).astype(np.int64)
    return np.unique(turns, axis=0, return_inverse=True)[1].reshape(-1)


ROWS_AT_ONCE = 256
LISTED_ROWS = 20


@dataclass(frozen=True)
class ArraySummary:
    """One array: its shape and type, its least and greatest finite value, what to know of it."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    least: float | None = None
    most: float | None = None
    note: str = ""


@dataclass(frozen=True)
class Summary:
    """facts: further lines of text; classes: scenes by their number of homology classes."""

    arrays: tuple[ArraySummary, ...]
    facts: tuple[str, ...]
    families: Mapping[str, int] = field(default_factory=dict)
    classes: Mapping[int, int] = field(default_factory=dict)


def inspect_trajectories(dataset: TrajectoryDataset) -> Summary:
    """Shapes and ranges of a trajectory file, and which rows are not finite."""
    arrays = []
    for name, array in dataset.arrays.items():
        least, most = _extent(array.read(rows) for rows in _slices(dataset.count))
        bad = dataset.not_finite.get(name)
        notes = [] if array.on_disk else ["in memory"]
        if bad is not None:
            notes.append(f"not finite in {len(bad)} rows: {_listed(bad)}")
        arrays.append(
            ArraySummary(name, array.shape, str(array.dtype), least, most, "; ".join(notes))
        )
    dt = "unknown" if dataset.dt is None else in_words(dataset.dt)
    lasting = "" if dataset.durations is None else f", duration {in_words(dataset.durations)}"
    facts = [
        f"{len(dataset)} of {dataset.count} samples, T {dataset.num_steps}, D {dataset.dim}, "
        f"dt {dt}{lasting}"
    ]
    if len(dataset.left_out):
        facts.append(
            f"left out, not finite: {len(dataset.left_out)} rows: {_listed(dataset.left_out)}"
        )
    for name in FIELDS:
        found = getattr(dataset.statistics, name)
        columns = ", ".join(
            f"{mean:.3g} ± {std:.3g}" for mean, std in zip(found.mean, found.std, strict=True)
        )
        facts.append(f"{name}: {columns}")
    for name, peaks in (
        ("speed", dataset.peak_speed),
        ("acceleration", dataset.peak_acceleration),
    ):
        half, nearly, most = np.quantile(peaks, [0.5, 0.995, 1.0])
        facts.append(f"peak {name}: median {half:.3g}, 99.5 % {nearly:.3g}, greatest {most:.3g}")
    if dataset.ignored:
        facts.append(f"arrays that nothing reads: {', '.join(dataset.ignored)}")
    return Summary(tuple(arrays), tuple(facts))


def inspect_scenes(dataset: SceneDataset, *, scenes: int) -> Summary:
    """Shapes and ranges of a scene dataset; homology classes of `scenes` scenes, evenly spread."""
    arrays = []
    for name, array in dataset.arrays.items():
        least, most = _extent(array[rows] for rows in _slices(len(array)))
        bad = np.concatenate([_not_finite(array[rows], rows.start) for rows in _slices(len(array))])
        note = f"not finite in {len(bad)} rows: {_listed(bad)}" if len(bad) else ""
        arrays.append(ArraySummary(name, array.shape, str(array.dtype), least, most, note))
    facts = [
        f"{len(dataset)} scenes, M {dataset.arrays['states'].shape[1]}, T {dataset.num_steps}, "
        f"D {dataset.dim}",
        *limits_in_words(dataset.limits, dataset.meta.get("ranges") or {}),
        f"durations {in_words(dataset.arrays['durations'])}; scenes with a given horizon "
        f"{np.mean(dataset.arrays['limits'][:, 3] > 0):.0%}",
    ]
    facts += [f"{key}: {dataset.meta[key]}" for key in ("left_out",) if key in dataset.meta]
    picked = np.unique(np.linspace(0, len(dataset) - 1, min(scenes, len(dataset))).astype(int))
    classes = Counter(count_classes(dataset, int(scene)) for scene in picked)
    families = dict(dataset.meta.get("families") or {})
    return Summary(tuple(arrays), tuple(facts), families, dict(sorted(classes.items())))


def limits_in_words(limits: MotionLimits, ranges: Mapping[str, tuple[float, float]]) -> list[str]:
    """Lines that say what trajectories keep, and what the data's robots differ in."""
    horizon = "open" if limits.horizon_s is None else f"{limits.horizon_s:g} s"
    lines = [f"v_max {limits.v_max:g} m/s, a_max {limits.a_max:g} m/s^2, horizon {horizon}"]
    told = [
        f"{name} {ranges[name][0]:g} to {ranges[name][1]:g} {interval.unit}"
        for name, interval in LIMITS.items()
        if name in ranges
    ]
    return [*lines, "ranges: " + ", ".join(told)] if told else lines


def count_classes(dataset: SceneDataset, scene: int) -> int:
    """How many homology classes a scene's trajectories are in."""
    *origin, resolution = dataset.arrays["map_geometry"][scene].tolist()
    clearance = np.asarray(dataset.arrays["clearance"][scene], np.float32)
    points = obstacle_points(clearance, resolution, np.array(origin))
    positions = dataset.arrays["states"][scene][..., : dataset.dim]
    return len(np.unique(homology_classes(positions, points)))


def _slices(count: int) -> list[slice]:
    return [slice(i, min(i + ROWS_AT_ONCE, count)) for i in range(0, count, ROWS_AT_ONCE)]


def _extent(blocks: Any) -> tuple[float | None, float | None]:
    """Least and greatest finite value of blocks."""
    least, most = np.inf, -np.inf
    for block in blocks:
        finite = block[np.isfinite(block)]
        if finite.size:
            least, most = min(least, float(finite.min())), max(most, float(finite.max()))
    return (None, None) if least > most else (least, most)


def _not_finite(block: NDArray[Any], first_row: int) -> NDArray[np.int64]:
    return first_row + np.flatnonzero(~np.isfinite(block.reshape(len(block), -1)).all(1))


def _listed(rows: NDArray[np.int64]) -> str:
    shown = ", ".join(map(str, rows[:LISTED_ROWS]))
    return shown + (", ..." if len(rows) > LISTED_ROWS else "")
