"""Mean, spread and range of trajectories: what a dataset is normalised by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
