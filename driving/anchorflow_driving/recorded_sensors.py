"""Which files of a recording vehicle's cameras and LiDAR belong to the frames of a log."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import LIDAR_BEFORE_S
from anchorflow_driving.errors import UNREADABLE, LogError

CAMERAS = ("left", "front", "right")
BEFORE_FRAMES = round(LIDAR_BEFORE_S / 0.1)
"""Frames between the two sweeps of a planner's inputs."""
PREFIX = "sensor_"
"""Of the fields' names in a log's file."""
# Field: kind of dtype and shape.
LAYOUT: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "folder": ("U", ()),
    "rectified": ("b", ()),
    "camera_file": ("U", (3, "F")),
    "camera_lens": ("f", (3, "F", 9)),
    "camera_turn": ("f", (3, "F", 3, 3)),
    "lidar_file": ("U", ("F",)),
    "lidar_mount": ("f", ("F", 3, 4)),
    "lidar_pose": ("f", ("F", 3)),
}
KINDS = {"U": "str", "b": "bool", "f": "float32"}


@dataclass(frozen=True, eq=False)
class RecordedSensors:
    """The files nearest in time to each of F frames, and how the sensors were mounted.

    A file's name is "" where no file is near. Axes of a camera: x right, y down, z ahead.
    """

    folder: str  # that the files' names begin from
    rectified: bool  # pictures are turned into those of the reference cameras
    camera_file: NDArray[np.str_]  # [3, F] of CAMERAS
    camera_lens: NDArray[np.float32]  # [3, F, 9] fx, fy, cx, cy, pixels; k1, k2, p1, p2, k3
    camera_turn: NDArray[np.float32]  # [3, F, 3, 3] from the camera's axes to the vehicle's
    lidar_file: NDArray[np.str_]  # [F]
    lidar_mount: NDArray[np.float32]  # [F, 3, 4] from the LiDAR to its rear axle on the ground
    lidar_pose: NDArray[np.float32]  # [F, 3] that axle at the sweep's time, in the log's frame

    @property
    def complete(self) -> NDArray[np.bool_]:
        """[F] whether pictures, a sweep, and the sweep of LIDAR_BEFORE_S before are there."""
        swept = self.lidar_file != ""
        before = np.concatenate([np.zeros(BEFORE_FRAMES, bool), swept[:-BEFORE_FRAMES]])
        return (self.camera_file != "").all(0) & swept & before[: len(swept)]

    def picture(self, camera: int, frame: int) -> Path:
        """The file of one of CAMERAS. Raises `LogError` if none is near that frame."""
        return self._near(f"camera {CAMERAS[camera]}", self.camera_file[camera], frame)

    def sweep(self, frame: int) -> Path:
        """The LiDAR's file. Raises `LogError` if none is near that frame."""
        return self._near("LiDAR", self.lidar_file, frame)

    def _near(self, sensor: str, files: NDArray[np.str_], frame: int) -> Path:
        name = str(files[frame]) if frame >= 0 else ""  # a log begins at frame 0
        if not name:
            expected = f"a file near frame {frame}"
            raise LogError(self.folder, sensor, expected=expected, found="none in the log")
        return Path(self.folder, name)

    def check_files(self, frames: Iterable[int]) -> None:
        """Raise `LogError` with the first file that is missing, of those of complete frames."""
        wanted: dict[Path, str] = {}
        for frame in frames:
            wanted |= {self.picture(n, frame): f"camera {each}" for n, each in enumerate(CAMERAS)}
            wanted |= {self.sweep(each): "LiDAR" for each in (frame, frame - BEFORE_FRAMES)}
        missing = [path for path in wanted if not path.is_file()]
        if missing:
            found = f"nothing; {len(missing)} of {len(wanted)} files are missing"
            raise LogError(missing[0], wanted[missing[0]], expected="its file", found=found)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The fields as a log's file holds them."""
        return {
            PREFIX + field.name: np.asarray(getattr(self, field.name)) for field in fields(self)
        }

    def check(self, path: Path | str, frames: int) -> None:
        """Raise `LogError` for a field of another dtype or shape than F = `frames` needs."""
        for name, (kind, axes) in LAYOUT.items():
            array = np.asarray(getattr(self, name))
            shape = tuple(frames if axis == "F" else axis for axis in axes)
            if array.dtype.kind != kind or array.shape != shape:
                expected, found = f"{KINDS[kind]} {list(shape)}", f"{array.dtype} {[*array.shape]}"
                raise LogError(path, PREFIX + name, expected=expected, found=found)
            if kind == "f" and not np.isfinite(array).all():
                raise LogError(path, PREFIX + name, expected="finite numbers", found="NaN")


def kinds_of(sensors: Iterable[RecordedSensors | None]) -> str:
    """Say whether the sensors of logs are recorded, simulated, or both."""
    kinds = {"simulated" if each is None else "recorded" for each in sensors}
    return ", ".join(sorted(kinds))


def read_sensors(path: Path | str) -> RecordedSensors | None:
    """The recorded sensors of a log's file; None if it has none.

    Raises `LogError` if a field is missing or cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            if PREFIX + "folder" not in file.files:
                return None
            # numpy gives the bytes of what is no array.
            read: dict[str, Any] = {name: np.asarray(file[PREFIX + name]) for name in LAYOUT}
    except (*UNREADABLE, KeyError) as error:
        expected = "the fields of recorded sensors"
        raise LogError(path, PREFIX + "folder", expected=expected, found=str(error)) from error
    scalars = {name: read[name].item() for name in ("folder", "rectified") if not read[name].ndim}
    return RecordedSensors(**{**read, **scalars})
