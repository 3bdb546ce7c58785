"""The dataset on disk: a folder of `.npy` arrays, memory-mapped, with a `dataset.json` beside them.

S scenes, M trajectories a scene, T samples, D dimensions, map [C, H, W]:

    cost_map      uint8   [S, C, H, W]  `Scene.network_map`; 255 is 1.0
    clearance     float16 [S, H, W]     m beyond robot_radius
    map_geometry  float32 [S, 3]        origin x, origin y in m, resolution in m/cell
    x_curr        float32 [S, 3D]       p, v, a
    x_goal        float32 [S, 2D]       p, v
    w_style       float32 [S, 3]        `Scene.effective_style`
    limits        float32 [S, 4]        v_max, a_max, robot_radius, horizon_s or 0 where it is open
    route_states  float32 [S, R, T, 3D + 1]  along each route, as `Scene.route_states`; the
                                        routes that a scene has less of are zero
    states        float32 [S, M, T, 3D] the expert's p, v, a; a scene with fewer repeats them
    durations     float32 [S, M]        s that each trajectory lasts
    route         uint8   [S, M]        the place of the route that each follows
    starts        float32 [S, M, D F + 1]  what the expert's try began with, as
                                        `RouteSplines.disturbance`; optional
    quality       float32 [S, M]        in [0, 1], what a trajectory counts in the loss; optional
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.fields import LIMITS
from anchorflow_client.errors import AnchorFlowError
from anchorflow_driving.errors import UNREADABLE
from anchorflow_training.atomic_write import atomic_write, writing
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.search import MOST_ROUTES
from anchorflow_trajectory.scene import Scene

Row = dict[str, NDArray[Any]]

DTYPES = {
    "cost_map": np.uint8,
    "clearance": np.float16,
    "map_geometry": np.float32,
    "x_curr": np.float32,
    "x_goal": np.float32,
    "w_style": np.float32,
    "limits": np.float32,
    "route_states": np.float32,
    "states": np.float32,
    "durations": np.float32,
    "route": np.uint8,
}
OPTIONAL_DTYPES = {"starts": np.float32, "quality": np.float32}
FINITE = tuple(name for name, dtype in DTYPES.items() if dtype is np.float32)


class DatasetError(AnchorFlowError):
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
        """The usual robot's limits, with a horizon if all scenes share it; or `DatasetError`."""
        found: Any = self.meta.get("limits")
        try:
            return MotionLimits(**found)
        except TypeError as error:
            raise DatasetError(
                f"{self.path / 'dataset.json'}: limits: expected v_max, a_max and horizon_s, "
                f"found {found}"
            ) from error

    @cached_property
    def mean_quality(self) -> float | None:
        """Over all trajectories; None where all count alike. Raises `DatasetError` if it is 0."""
        if "quality" not in self.arrays:
            return None
        mean = float(self.arrays["quality"].mean(dtype=np.float64))
        if not mean > 0:
            raise DatasetError(
                f"{self.path / 'quality.npy'}: expected more than 0 in some of {len(self)} scenes, "
                "found 0 in all: none would count in the loss"
            )
        return mean

    def check_finite(self, scenes: NDArray[np.int64]) -> None:
        """Raise `DatasetError` naming the first of these scenes whose numbers are not finite."""
        for name in FINITE:
            finite = np.isfinite(self.arrays[name][scenes].reshape(len(scenes), -1)).all(1)
            if not finite.all():
                raise DatasetError(
                    f"{self.path / name}.npy: expected finite numbers, found others in scene "
                    f"{scenes[np.argmin(finite)]}"
                )

    def batch(self, scenes: NDArray[np.int64]) -> dict[str, NDArray[np.float32]]:
        """The named arrays of some scenes in float32 and SI units; cost_map in [0, 1].

        Raises `DatasetError` if a scene has a number that is not finite.
        """
        self.check_finite(scenes)
        rows = {name: array[scenes].astype(np.float32) for name, array in self.arrays.items()}
        rows["cost_map"] /= 255.0
        return rows


def open_dataset(path: Path) -> SceneDataset:
    """Memory-map a dataset folder; raises `DatasetError` naming the file that is wrong."""
    try:
        meta = json.loads((path / "dataset.json").read_text())
    except FileNotFoundError as error:
        found = "driving logs, of which another planner learns" if [*path.glob("*.npz")] else "none"
        raise DatasetError(
            f"{path}: expected a dataset, with a dataset.json, found {found}"
        ) from error
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path / 'dataset.json'}: {error}") from error
    scenes = meta.get("scenes") if isinstance(meta, dict) else None
    if not isinstance(scenes, int):
        raise DatasetError(f"{path / 'dataset.json'}: scenes: expected a number, found {scenes}")
    _check_told(path / "dataset.json", meta)
    arrays = {name: _opened(path, name, scenes) for name in DTYPES}
    for name in OPTIONAL_DTYPES:
        if (path / f"{name}.npy").exists():
            arrays[name] = _opened(path, name, scenes)
    _check_shapes(path, arrays)
    _check_quality(path, arrays)
    return SceneDataset(path, arrays, meta)


def scene_row(
    scene: Scene,
    states: NDArray[np.float32],
    *,
    durations: NDArray[np.floating],
    route: NDArray[np.integer],
) -> Row:
    """A scene and its trajectories' states [M, T, 3D] as a dataset keeps them.

    durations: [M] s; route: [M] the place of the route that each follows
    """
    routes = scene.route_states
    row = {
        "cost_map": np.rint(scene.network_map * 255),
        "clearance": scene.clearance_field,
        "map_geometry": scene.map_geometry,
        "x_curr": scene.x_curr,
        "x_goal": scene.x_goal,
        "w_style": scene.effective_style,
        "limits": scene.limits,
        "route_states": np.pad(routes, [(0, MOST_ROUTES - len(routes)), (0, 0), (0, 0)]),
        "states": states,
        "durations": durations,
        "route": route,
    }
    return {name: row[name].astype(dtype) for name, dtype in DTYPES.items()}


def own_time_states(
    states: NDArray[np.floating], durations: NDArray[np.floating]
) -> NDArray[np.float32]:
    """p, v, a [..., T, 3D] that last [...] s as the model's states [..., T, 3D + 1]."""
    lasting = durations[..., None, None]
    fields = np.split(states, 3, axis=-1)
    scaled = [part * lasting**order for order, part in enumerate(fields)]
    last = np.broadcast_to(np.log(lasting), (*states.shape[:-1], 1))
    return np.concatenate([*scaled, last], -1, dtype=np.float32)


def _opened(path: Path, name: str, scenes: int) -> NDArray:
    file, dtype = path / f"{name}.npy", np.dtype((DTYPES | OPTIONAL_DTYPES)[name])
    try:
        array = np.load(file, mmap_mode="r")
    except UNREADABLE as error:
        raise DatasetError(f"{file}: {error}") from error
    if array.dtype != dtype or not array.ndim or len(array) != scenes:
        raise DatasetError(
            f"{file}: expected {dtype} [{scenes}, ...], found {array.dtype} {list(array.shape)}"
        )
    return array


def _check_told(file: Path, meta: Mapping[str, Any]) -> None:
    """Check the entries of `dataset.json` on robots and families, if present."""
    for name in ("limits", "ranges", "families"):
        if not isinstance(meta.get(name) or {}, dict):
            raise DatasetError(f"{file}: {name}: expected an object, found {meta[name]!r}")
    for name, value in (meta.get("limits") or {}).items():
        if not (_is_number(value) or (name == "horizon_s" and value is None)):
            raise DatasetError(f"{file}: limits.{name}: expected a number, found {value!r}")
    ranges = meta.get("ranges") or {}
    for name in LIMITS.keys() & ranges:
        if not _is_range(ranges[name]):
            raise DatasetError(
                f"{file}: ranges.{name}: expected the least and the greatest number, "
                f"found {ranges[name]!r}"
            )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _is_range(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(map(_is_number, value))
        and value[0] <= value[1]
    )


def _check_shapes(path: Path, arrays: Mapping[str, NDArray]) -> None:
    """Whether the arrays belong together; states and cost_map say what the others must be."""
    for name, letters, divisor in (("states", "S, M, T, 3D", 3), ("cost_map", "S, C, H, W", 1)):
        shape = arrays[name].shape
        if len(shape) != 4 or 0 in shape or shape[-1] % divisor:
            raise DatasetError(
                f"{path / name}.npy: expected [{letters}], all above 0, found {list(shape)}"
            )
    scenes, trajectories, steps, width = arrays["states"].shape
    cells = arrays["cost_map"].shape[2:]
    expected = {
        "clearance": cells,
        "map_geometry": (3,),
        "x_curr": (width,),
        "x_goal": (2 * width // 3,),
        "w_style": (3,),
        "limits": (4,),
        "route_states": (MOST_ROUTES, steps, width + 1),
        "durations": (trajectories,),
        "route": (trajectories,),
        "quality": (trajectories,),
        "starts": (trajectories, *arrays["starts"].shape[2:]) if "starts" in arrays else (),
    }
    for name, shape in expected.items():
        if name in arrays and arrays[name].shape != (scenes, *shape):
            raise DatasetError(
                f"{path / name}.npy: expected {[scenes, *shape]} beside states "
                f"{list(arrays['states'].shape)} and cost_map {list(arrays['cost_map'].shape)}, "
                f"found {list(arrays[name].shape)}"
            )


def _check_quality(path: Path, arrays: Mapping[str, NDArray]) -> None:
    if "quality" not in arrays:
        return
    quality, file = arrays["quality"], path / "quality.npy"
    wrong = ~((quality >= 0) & (quality <= 1))
    if wrong.any():
        scene = int(np.argmax(wrong.any(1)))
        raise DatasetError(
            f"{file}: expected values in [0, 1], found {quality[scene][wrong[scene]][0]:g} "
            f"in scene {scene}"
        )


def write_meta(path: Path, meta: Mapping[str, Any]) -> None:
    """Write a folder's `dataset.json`, whole or not at all, when all else is in place.

    Raises `DatasetError` if it cannot be written.
    """
    file = path / "dataset.json"
    with writing(file, DatasetError), atomic_write(file) as stream:
        stream.write(json.dumps(meta, indent=1).encode())


def create_arrays(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, NDArray]:
    """New writable `.npy` files under `path`, one for each array of `shapes`.

    Raises `DatasetError` if `path` is no folder, or one that cannot be written or holds no more.
    """
    arrays = {}
    try:
        path.mkdir(parents=True, exist_ok=True)
        # Without it, an interrupted folder is no dataset.
        (path / "dataset.json").unlink(missing_ok=True)
        for name, dtype in (DTYPES | OPTIONAL_DTYPES).items():
            file = path / f"{name}.npy"
            if name in shapes:
                arrays[name] = np.lib.format.open_memmap(file, "w+", dtype, shapes[name])
                reserve(file)
            else:
                file.unlink(missing_ok=True)  # of an earlier dataset in this folder
    except OSError as error:
        for name in arrays:
            (path / f"{name}.npy").unlink()
        raise DatasetError(f"{path}: expected a folder to write to ({error})") from error
    return arrays


def reserve(file: Path) -> None:
    """Allocate a file's holes: on a full disk, writing to a memory map would kill the process.

    Raises `OSError` if there is not as much.
    """
    if hasattr(os, "posix_fallocate"):
        with file.open("r+b") as stream:
            os.posix_fallocate(stream.fileno(), 0, file.stat().st_size)


def shrink_arrays(path: Path, scenes: int) -> None:
    """Cut the files that `create_arrays` made to their first `scenes` rows, in place."""
    for name in DTYPES | OPTIONAL_DTYPES:
        file = path / f"{name}.npy"
        if name in OPTIONAL_DTYPES and not file.exists():
            continue
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
