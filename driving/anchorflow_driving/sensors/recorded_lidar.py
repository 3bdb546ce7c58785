"""Recorded LiDAR sweeps in the frame of the rear axle now: nuScenes' `.pcd.bin`, and `.pcd`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import lidar_histogram
from anchorflow_driving.errors import LogError
from anchorflow_driving.geometry import into_frame, out_of_frame
from anchorflow_driving.recorded_sensors import BEFORE_FRAMES, RecordedSensors
from anchorflow_driving.window import PlannerView

COLUMNS = 5
"""float32 of a point in a `.pcd.bin`: x, y, z, intensity, ring."""
OWN_MARGIN = 0.2
"""m around the ego's box within which points are its own body's, its mirrors included."""
_TYPES = {"F": "f", "I": "i", "U": "u"}


def recorded_lidar(view: PlannerView, sensors: RecordedSensors) -> NDArray[np.float32]:
    """The histogram [1, 256, 256] of the sweep nearest to now."""
    return lidar_histogram(sweep(view, sensors))


def recorded_lidar_before(view: PlannerView, sensors: RecordedSensors) -> NDArray[np.float32]:
    """The histogram [1, 256, 256] of the sweep of LIDAR_BEFORE_S ago, in the frame of now."""
    return lidar_histogram(sweep(view, sensors, frames_ago=BEFORE_FRAMES))


def sweep(
    view: PlannerView, sensors: RecordedSensors, *, frames_ago: int = 0
) -> NDArray[np.float32]:
    """Points [P, 3] m of a sweep: x, y in the rear axle's frame now, z above the ground then.

    The vehicle moved between the sweep and now, and was where the recording says. Points on its own
    body and points that are not finite are left out.

    Raises `LogError` if the file is missing or damaged.
    """
    frame = view.frame - frames_ago
    mount = sensors.lidar_mount[frame].astype(np.float64)
    points = read_points(sensors.sweep(frame)) @ mount[:, :3].T
    points += mount[:, 3]
    pose = into_frame(sensors.lidar_pose[frame].astype(np.float64), view.state.pose)
    points[:, :2] = out_of_frame(points[:, :2], pose)
    body = into_frame(points[:, :2], view.tracks[view.ego, -1 - frames_ago, :3])
    own = (np.abs(body) < view.vehicle.size / 2 + OWN_MARGIN).all(-1)
    return points[~own].astype(np.float32)


def read_points(path: Path) -> NDArray[np.float64]:
    """The finite points [P, 3] of a sweep's file, in the sensor's frame.

    Raises `LogError` if there is no file, or it is neither a `.pcd.bin` nor a binary `.pcd`.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogError(path, "LiDAR", expected="a sweep's file", found=str(error)) from error
    if path.suffix == ".pcd":
        points = _pcd(path, data)
    elif len(data) % (4 * COLUMNS):
        expected = f"points of {COLUMNS} float32"
        raise LogError(path, "LiDAR", expected=expected, found=f"{len(data)} bytes")
    else:
        points = np.frombuffer(data, "<f4").reshape(-1, COLUMNS)[:, :3].astype(np.float64)
    return points[np.isfinite(points).all(1)]


def _pcd(path: Path, data: bytes) -> NDArray[np.float64]:
    """Points of the Point Cloud Data format, `DATA binary`."""
    header: dict[str, list[str]] = {}
    rest = data
    while "DATA" not in header:
        line, newline, rest = rest.partition(b"\n")
        if not newline:
            raise LogError(path, "LiDAR", expected="the header of a .pcd", found="no line DATA")
        key, *values = line.decode("ascii", "replace").split() or ["#"]
        header[key.upper()] = values
    try:
        if header["DATA"] != ["binary"]:
            raise ValueError(f"DATA {' '.join(header['DATA'])}")
        counts = header.get("COUNT", ["1"] * len(header["FIELDS"]))
        columns = [
            (f"{name} {n}", f"<{_TYPES[kind]}{size}", int(count))
            for n, (name, kind, size, count) in enumerate(
                zip(header["FIELDS"], header["TYPE"], header["SIZE"], counts, strict=True)
            )
        ]
        first = [f"{axis} {header['FIELDS'].index(axis)}" for axis in "xyz"]
        rows = np.frombuffer(rest, np.dtype(columns), count=int(header["POINTS"][0]))
        return np.concatenate([rows[name].astype(np.float64) for name in first], axis=1)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        expected = "a .pcd with x, y, z and DATA binary"
        raise LogError(path, "LiDAR", expected=expected, found=str(error)) from error
