"""One pass over a trajectory file: its statistics, and the rows that are not numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.data.trajectory_statistics import FIELDS, Moments, TrajectoryStatistics

MOST_FLOAT32 = np.finfo(np.float32).max


@dataclass(frozen=True)
class Survey:
    """What one pass found.

    finite: [N] bool; not_finite: the rows [n] of each array that has any
    peak_speed, peak_acceleration: [N], greatest planar length along each sample, m/s and m/s^2
    """

    finite: NDArray[np.bool_]
    not_finite: Mapping[str, NDArray[np.int64]]
    peak_speed: NDArray[np.float32]
    peak_acceleration: NDArray[np.float32]
    statistics: TrajectoryStatistics | None


@dataclass
class Surveyor:
    """Collects a `Survey` block by block."""

    finite: list[NDArray[np.bool_]] = field(default_factory=list)
    not_finite: dict[str, list[NDArray[np.int64]]] = field(default_factory=dict)
    peaks: list[NDArray[np.float32]] = field(default_factory=list)
    moments: tuple[Moments, ...] = field(default_factory=lambda: tuple(Moments() for _ in FIELDS))

    def add(
        self, first_row: int, arrays: Mapping[str, NDArray[Any]], states: Iterable[NDArray[Any]]
    ) -> None:
        """arrays: blocks as they stand in the file; states: p, v, a [n, T, D] made of them."""
        count = len(next(iter(arrays.values())))
        finite = np.ones(count, bool)
        for name, block in arrays.items():
            if block.dtype.kind != "f":
                continue
            good = np.isfinite(block.reshape(count, -1)).all(1)
            finite &= good
            if not good.all():
                self.not_finite.setdefault(name, []).append(first_row + np.flatnonzero(~good))
        states = list(states)
        for values in states:
            # Differences of finite numbers, and their float32, need not be finite.
            finite &= (np.abs(values) <= MOST_FLOAT32).all((1, 2))
        self.finite.append(finite)
        good_states = [values[finite] for values in states]
        for moments, values in zip(self.moments, good_states, strict=True):
            moments.add(values)
        peaks = np.zeros((2, count), np.float32)
        if finite.any():
            for row, values in zip(peaks, good_states[1:], strict=True):
                row[finite] = np.linalg.norm(values[..., :2], axis=-1).max(1)
        self.peaks.append(peaks)

    def result(self) -> Survey:
        finite = np.concatenate(self.finite)
        speed, acceleration = np.concatenate(self.peaks, 1)
        rows = {name: np.concatenate(parts) for name, parts in self.not_finite.items()}
        statistics = None
        if finite.any():
            fields = dict(zip(FIELDS, (m.result() for m in self.moments), strict=True))
            statistics = TrajectoryStatistics(count=int(finite.sum()), **fields)
        return Survey(finite, rows, speed, acceleration, statistics)
