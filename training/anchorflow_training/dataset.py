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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.scene import Scene

Row = dict[str, NDArray[Any]]

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
MOST_FLOAT16 = float(np.finfo(np.float16).max)


class DatasetError(Exception):
    """A dataset folder is not what it should be; the message names the file."""


@dataclass(frozen=True)
class SceneDataset:
    """Arrays of one dataset folder, opened by `open_dataset`."""

    path: Path
    arrays: Mapping[str, NDArray]
    meta: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.arrays["states"])

    @property
    def num_steps(self) -> int:
        """T."""
        return self.arrays["states"].shape[2]

    @property
    def dim(self) -> int:
        """D: 2, or 3 with a heading in rad."""
        return self.arrays["states"].shape[3] // 3

    @property
    def map_channels(self) -> int:
        """C."""
        return self.arrays["cost_map"].shape[1]

    @property
    def limits(self) -> MotionLimits:
        """What the trajectories keep, and how long they take; raises `DatasetError` if unsaid."""
        # Folders of before 0.1 say it in the expert's configuration alone.
        found = self.meta.get("limits") or self.meta.get("config", {}).get("limits")
        try:
            return MotionLimits(**found)
        except TypeError as error:
            raise DatasetError(
                f"{self.path / 'dataset.json'}: limits: expected v_max, a_max and horizon_s, "
                f"found {found}"
            ) from error

    def batch(self, scenes: NDArray[np.int64]) -> dict[str, NDArray[np.float32]]:
        """The named arrays of some scenes in float32 and SI units; cost_map in [0, 1]."""
        rows = {name: array[scenes].astype(np.float32) for name, array in self.arrays.items()}
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
            raise DatasetError(
                f"{file}: expected {np.dtype(dtype)} [{meta['scenes']}, ...], found {found}"
            )
    return SceneDataset(path, arrays, meta)


def scene_row(scene: Scene, states: NDArray[np.float32]) -> Row:
    """A scene and its trajectories' states [M, T, 3D] as a dataset keeps them."""
    row = {
        "cost_map": np.rint(scene.cost_map * 255),
        "clearance": scene.clearance_field,
        "cost_to_go": np.minimum(scene.cost_to_go, MOST_FLOAT16),
        "map_geometry": scene.map_geometry,
        "x_curr": scene.x_curr,
        "x_goal": scene.x_goal,
        "w_style": scene.w_style,
        "states": states,
    }
    return {name: row[name].astype(dtype) for name, dtype in DTYPES.items()}


def create_arrays(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, NDArray]:
    """New writable `.npy` files under `path`, one an array of the dataset."""
    path.mkdir(parents=True, exist_ok=True)
    return {
        name: np.lib.format.open_memmap(path / f"{name}.npy", "w+", dtype, shapes[name])
        for name, dtype in DTYPES.items()
    }


def shrink_arrays(path: Path, scenes: int) -> None:
    """Cut the files that `create_arrays` made to their first `scenes` rows, in place."""
    for name in DTYPES:
        file = path / f"{name}.npy"
        array = np.load(file, mmap_mode="r")
        header = {"descr": array.dtype.str, "fortran_order": False}
        rows, row_bytes, offset = array.shape[1:], array[:1].nbytes, array.offset
        del array
        with file.open("r+b") as stream:
            # numpy leaves room in the header for the first axis to change, so the data stay put.
            np.lib.format.write_array_header_1_0(stream, header | {"shape": (scenes, *rows)})
            if stream.tell() != offset:
                raise DatasetError(f"{file}: expected a header of {offset} bytes")
            stream.truncate(offset + scenes * row_bytes)
