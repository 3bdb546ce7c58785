"""A vocabulary of goals: where the trajectories of the data end, clustered."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

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
    centres, _ = kmeans2(points, count, iter=ITERATIONS, minit="++", seed=rng, missing="warn")
    return centres[np.argsort(np.linalg.norm(centres, axis=1))].astype(np.float32)


def read_vocabulary(path: Path, *, count: int) -> NDArray[np.float32]:
    """Goals [K, 2] of a .npy file.

    Raises:
        ConfigError: it cannot be read, or holds anything but K pairs of finite numbers.
    """
    try:
        goals = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise ConfigError(f"vocabulary: {path}: {error}") from error
    if goals.shape != (count, 2):
        raise ConfigError(f"vocabulary: {path}: expected [{count}, 2], got {list(goals.shape)}")
    if goals.dtype.kind not in "iuf" or not np.isfinite(goals).all():
        raise ConfigError(f"vocabulary: {path}: expected finite numbers, got {goals.dtype}")
    return goals.astype(np.float32)
