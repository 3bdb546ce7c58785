"""The dataset on disk: a folder of `.npy` arrays, memory-mapped, with a `dataset.json` beside them.

S scenes, M trajectories a scene, T samples, D dimensions, map [C, H, W]:

    cost_map      uint8   [S, C, H, W]  255 is 1.0
    clearance     float16 [S, H, W]     m beyond robot_radius
    cost_to_go    float16 [S, 2, H, W]  m, from the start and to the goal
    map_geometry  float32 [S, 3]        origin x, origin y in m, resolution in m/cell
    x_curr        float32 [S, 3D]       p, v, a
    x_goal        float32 [S, 2D]       p, v
    w_style       float32 [S, 3]        sums to 1
    states        float32 [S, M, T, 3D] the expert's p, v, a; a scene with fewer repeats them
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

DTYPES = {
    "cost_map": np.uint8,
    "clearance": np.float16,
    "cost_to_go": np.float16,
    "map_geometry": np.float32,
    "x_curr": np.float32,
    "x_goal": np.float32,
    "w_style": np.float32,
    "states": np.float32,
}


class DatasetError(Exception):
    """A dataset folder is not what it should be; the message names the file."""


@dataclass(frozen=True)
class SceneDataset:
    """Arrays of one dataset folder, opened by `open_dataset`."""

    path: Path
    arrays: Mapping[str, NDArray]
    meta: Mapping[str, object]

    def __len__(self) -> int:
        return len(self.arrays["states"])

    def batch(self, scenes: NDArray[np.int64]) -> dict[str, NDArray[np.float32]]:
        """The named arrays of some scenes in float32 and SI units; cost_map in [0, 1]."""
        rows = {name: np.float32(array[scenes]) for name, array in self.arrays.items()}
        rows["cost_map"] /= 255.0
        return rows


def open_dataset(path: Path) -> SceneDataset:
    """Memory-map a dataset folder; raises `DatasetError` naming the file that is wrong."""
    try:
        meta = json.loads((path / "dataset.json").read_text())
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path / 'dataset.json'}: {error}") from error
    arrays = {}
    for name, dtype in DTYPES.items():
        file = path / f"{name}.npy"
        try:
            arrays[name] = np.load(file, mmap_mode="r")
        except (OSError, ValueError) as error:
            raise DatasetError(f"{file}: {error}") from error
        if arrays[name].dtype != dtype or len(arrays[name]) != meta["scenes"]:
            found = f"{arrays[name].dtype} {arrays[name].shape}"
            raise DatasetError(f"{file}: expected {np.dtype(dtype)} [{meta['scenes']}, ...], found {found}")
    return SceneDataset(path, arrays, meta)


def create_arrays(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, NDArray]:
    """New writable `.npy` files under `path`, one an array of the dataset."""
    path.mkdir(parents=True, exist_ok=True)
    return {
        name: np.lib.format.open_memmap(path / f"{name}.npy", "w+", dtype, shapes[name])
        for name, dtype in DTYPES.items()
    }
