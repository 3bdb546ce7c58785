"""Give a log's frames the files of recorded sensors that are nearest in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from anchorflow_driving.geometry import Array
from anchorflow_driving.importers.fields import Entry
from anchorflow_driving.recorded_sensors import CAMERAS, RecordedSensors

NEAR_S = 0.1
"""s between a frame and its file, at most."""


@dataclass(frozen=True, eq=False)
class SensorFile:
    """A picture or a sweep."""

    time: float  # s since the log's first frame
    name: str  # in the folder of sensors
    mount: Array  # [3, 4] from the sensor's frame to that of the rear axle on the ground
    pose: Array  # [3] of that axle at this time, in the recording's frame
    lens: Array | None = None  # [9] of a camera, as `RecordedSensors` has it


@dataclass(frozen=True, eq=False)
class SensorFiles:
    """The files of a recording's left, front and right camera and of its LiDAR, in any order."""

    folder: Path
    rectified: bool
    cameras: Sequence[Sequence[SensorFile]]
    lidar: Sequence[SensorFile]

    def at(self, now: Array, *, origin: Array) -> RecordedSensors:
        """Return those nearest to times [F] s; `origin` [2] becomes (0, 0)."""
        frames = len(now)
        cameras = [_nearest(files, now) for files in self.cameras]
        sweeps = _nearest(self.lidar, now)
        lens, turn = np.zeros((len(CAMERAS), frames, 9)), np.zeros((len(CAMERAS), frames, 3, 3))
        for number, files in enumerate(cameras):
            for frame, file in enumerate(files):
                if file is not None and file.lens is not None:
                    lens[number, frame], turn[number, frame] = file.lens, file.mount[:, :3]
        mount, pose = np.zeros((frames, 3, 4)), np.zeros((frames, 3))
        for frame, file in enumerate(sweeps):
            if file is not None:
                mount[frame], pose[frame] = file.mount, file.pose - [*origin, 0.0]
        return RecordedSensors(
            folder=str(self.folder.resolve()),
            rectified=self.rectified,
            camera_file=np.array([_names(files) for files in cameras]),
            camera_lens=lens.astype(np.float32),
            camera_turn=turn.astype(np.float32),
            lidar_file=np.array(_names(sweeps)),
            lidar_mount=mount.astype(np.float32),
            lidar_pose=pose.astype(np.float32),
        )


def mounted(place: Entry, turn: Entry) -> Array:
    """[3, 4] from a sensor at a place x, y, z, turned by a unit quaternion w, x, y, z."""
    w, x, y, z = turn.numbers(4)
    if not np.isclose(np.hypot(np.hypot(w, x), np.hypot(y, z)), 1.0, atol=1e-3):
        raise turn.refuse("a quaternion of length 1", [w, x, y, z])
    return np.column_stack([Rotation.from_quat([x, y, z, w]).as_matrix(), place.numbers(3)])


def lens_of(intrinsic: Entry, distortion: Entry | None = None) -> Array:
    """[9] of a matrix [3, 3] of pixels and, if there is one, a distortion [5]."""
    matrix = intrinsic.numbers(3, 3)
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise intrinsic.refuse("focal lengths above 0", [matrix[0, 0], matrix[1, 1]])
    undone = np.zeros(5) if distortion is None else distortion.numbers(5)
    return np.array([*matrix[[0, 1], [0, 1]], *matrix[:2, 2], *undone])


def _nearest(files: Sequence[SensorFile], now: Array) -> list[SensorFile | None]:
    if not files:
        return [None] * len(now)
    times = np.array([file.time for file in files])
    nearest = [int(np.abs(times - each).argmin()) for each in now]
    return [
        files[index] if abs(times[index] - each) <= NEAR_S else None
        for index, each in zip(nearest, now, strict=True)
    ]


def _names(files: Sequence[SensorFile | None]) -> list[str]:
    return ["" if file is None else file.name for file in files]
