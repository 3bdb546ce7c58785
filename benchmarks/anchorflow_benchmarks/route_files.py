"""The known routes of a file of scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from anchorflow_benchmarks.array_files import read_arrays
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.scene_files import spread_evenly
from anchorflow_trajectory.ray_signature import Signature


def read_routes(path: Path) -> list[list[Signature]]:
    """The signatures of each scene's routes, the shortest first.

    The keys of the .npz file: count [S] routes of each scene; size [R] numbers in the signature of
    each route; signature, all of them in a row. Obstacles are in the order of `ObstacleRays`.

    Raises:
        BenchmarkError: the file cannot be read or lacks a key.
    """
    count, size, flat = read_arrays(path, ("count", "size", "signature"), what="routes").values()
    if count.sum() != len(size) or size.sum() != len(flat):
        raise BenchmarkError(f"{path}: not a file of routes (its counts do not add up)")
    parts = np.split(flat, np.cumsum(size)[:-1])
    routes = [tuple(part.tolist()) for part in parts]
    ends = np.cumsum(count).tolist()
    return [routes[end - n : end] for end, n in zip(ends, count.tolist(), strict=True)]


def load_routes(path: Path, *, scenes: int, limit: int | None = None) -> list[list[Signature]]:
    """Those of the scenes that `load_scenes` chooses for a limit.

    scenes: how many it chose

    Raises:
        BenchmarkError: the file is none of routes, or not of as many scenes.
    """
    found = spread_evenly(read_routes(path), limit)
    if len(found) != scenes:
        raise BenchmarkError(f"{path}: expected the routes of {scenes} scenes, got {len(found)}")
    return found
