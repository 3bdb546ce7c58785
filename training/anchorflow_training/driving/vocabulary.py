"""A vocabulary of goals: where the trajectories of the data end, clustered."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anchorflow_driving.errors import UNREADABLE
from anchorflow_training.settings import ConfigError

MOST_ENDS = 20_000  # that are clustered
ITERATIONS = 30


def clustered(ends: NDArray[np.floating], *, count: int, seed: int) -> NDArray[np.float32]:
    """K centres [K, P] of ends [M, 2] m, or of points of more numbers, the nearest to 0 first."""
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(ends), min(len(ends), MOST_ENDS), replace=False)
    points = np.asarray(ends, np.float64)[chosen]
    if len(points) < count:  # too few to cluster: the same ones, a little apart
        size = count, points.shape[1]
        points = np.resize(points, size) + rng.normal(0.0, 0.5, size)
    centres = _spread(points, count, rng)
    for _ in range(ITERATIONS):
        nearest = KDTree(centres).query(points)[1]
        members = np.bincount(nearest, minlength=count)
        sums = np.stack([np.bincount(nearest, axis, count) for axis in points.T], axis=-1)
        centres = np.where(members[:, None] > 0, sums / np.maximum(members, 1)[:, None], centres)
    return centres[np.argsort(np.linalg.norm(centres, axis=1))].astype(np.float32)


def _spread(
    points: NDArray[np.float64], count: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Points to begin with [K, F], each drawn by its squared distance from those before it
    (k-means++; Arthur and Vassilvitskii, 2007)."""
    centres = [points[rng.integers(len(points))]]
    away = np.full(len(points), np.inf)
    for _ in range(count - 1):
        away = np.minimum(away, ((points - centres[-1]) ** 2).sum(1))
        total = away.sum()
        chance = away / total if total > 0 else None
        centres.append(points[rng.choice(len(points), p=chance)])
    return np.stack(centres)


def read_vocabulary(path: Path, *, count: int) -> NDArray[np.float32]:
    """Goals [K, 2] of a .npy file.

    Raises:
        ConfigError: it cannot be read, or holds anything but K pairs of finite numbers.
    """
    try:
        goals = np.load(path, allow_pickle=False)
    except UNREADABLE as error:
        raise ConfigError(f"vocabulary: {path}: {error}") from error
    if goals.shape != (count, 2):
        raise ConfigError(f"vocabulary: {path}: expected [{count}, 2], got {list(goals.shape)}")
    if goals.dtype.kind not in "iuf" or not np.isfinite(goals).all():
        raise ConfigError(f"vocabulary: {path}: expected finite numbers, got {goals.dtype}")
    return goals.astype(np.float32)
