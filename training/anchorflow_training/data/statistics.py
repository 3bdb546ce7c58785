"""Statistics of trajectories, and the pass over a file that gathers them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

HEADING = 2  # the column of a heading, where D = 3


def central_differences(
    values: NDArray[np.floating], dt: float | NDArray[np.floating]
) -> NDArray[np.floating]:
    """d/dt of samples [..., T, D] that are `dt` seconds apart, T >= 3; dt may be [...].

    Central inside, one-sided over three points at both ends: exact for parabolas everywhere.
    """
    return np.gradient(values, axis=-2, edge_order=2) / np.asarray(dt)[..., None, None]


def unwrap_heading(positions: NDArray[np.floating]) -> NDArray[np.floating]:
    """Positions [..., T, D] whose heading, if any, runs on beyond pi from a start within it."""
    if positions.shape[-1] <= HEADING:
        return positions
    heading = np.unwrap(positions[..., HEADING], axis=-1)
    turns = np.round(heading[..., :1] / (2 * np.pi)) * (2 * np.pi)
    return np.concatenate([positions[..., :HEADING], (heading - turns)[..., None]], -1)


FIELDS = ("positions", "velocities", "accelerations")
SMALLEST_STD = 1e-6  # a dimension that never changes is shifted, not scaled


@dataclass(frozen=True)
class FieldStatistics:
    """[D] each, over all samples and steps of one field, in its SI unit."""

    mean: tuple[float, ...]
    std: tuple[float, ...]
    min: tuple[float, ...]
    max: tuple[float, ...]

    def normalise(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """(x - mean) / std of values [..., D]."""
        scale = np.maximum(np.asarray(self.std), SMALLEST_STD)
        return ((values - np.asarray(self.mean)) / scale).astype(np.float32)


@dataclass(frozen=True)
class TrajectoryStatistics:
    """What normalises a dataset; those of the training data serve its validation data too."""

    count: int
    positions: FieldStatistics
    velocities: FieldStatistics
    accelerations: FieldStatistics

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as `dataset.json` keeps them."""
        return asdict(self)

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> TrajectoryStatistics:
        fields = {
            name: FieldStatistics(**{key: tuple(values) for key, values in saved[name].items()})
            for name in FIELDS
        }
        return TrajectoryStatistics(count=saved["count"], **fields)


@dataclass
class Moments:
    """Running sums of one field; `shift` keeps a far-away origin from eating the digits."""

    count: int = 0
    shift: Any = 0.0
    sums: Any = 0.0
    squares: Any = 0.0
    least: Any = np.inf
    most: Any = -np.inf

    def add(self, values: NDArray[np.floating]) -> None:
        """Take samples [n, T, D] into account."""
        if not values.size:
            return
        # Dimension first: sums along the long axis are many times faster.
        points = np.ascontiguousarray(values.reshape(-1, values.shape[-1]).T, np.float64)
        if not self.count:
            self.shift = points.mean(1)
        self.count += points.shape[1]
        self.least = np.minimum(self.least, points.min(1))
        self.most = np.maximum(self.most, points.max(1))
        points -= self.shift[:, None]
        self.sums = self.sums + points.sum(1)
        self.squares = self.squares + np.einsum("dn,dn->d", points, points)

    def result(self) -> FieldStatistics:
        mean = self.sums / self.count
        variance = np.maximum(self.squares / self.count - mean**2, 0.0)
        parts = mean + self.shift, np.sqrt(variance), self.least, self.most
        return FieldStatistics(*(tuple(np.asarray(part).tolist()) for part in parts))


MOST_FLOAT32 = np.finfo(np.float32).max


@dataclass(frozen=True)
class Survey:
    """The result of a pass over a file.

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
        """arrays: blocks of the file; states: p, v, a [n, T, D] derived from them."""
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
