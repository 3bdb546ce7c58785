"""The known routes of a file of scenes."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

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
    try:
        with np.load(path) as file:
            count, size, flat = (file[name] for name in ("count", "size", "signature"))
        if count.sum() != len(size) or size.sum() != len(flat):
            raise ValueError("its counts do not add up")
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise BenchmarkError(f"{path}: not a file of routes ({error})") from error
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
