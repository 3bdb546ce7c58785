"""Goal, footprint, speed limit and tracks: from ROS messages to what a planner takes.

Messages are any objects with the fields of the ROS types, so this needs numpy alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import Obstacles
from anchorflow_client.contract.checks import Interval, number
from anchorflow_client.errors import InvalidRequest
from anchorflow_ros.frames import Frames, Pose

Array = NDArray[np.float64]

SPEED = Interval(0.0, 100.0, "m/s")
PERCENT = Interval(0.0, 100.0, "%")
TRACK_FIELDS = ("x", "y", "vx", "vy", "radius")
"""Fields of each point of the sensor_msgs/PointCloud2 that holds tracks; m and m/s."""
POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy's types by the `datatype` of a sensor_msgs/PointField."""


@dataclass(frozen=True)
class Goal:
    """A pose at which the robot has to stop."""

    frame_id: str
    pose: Pose
    stamp: float
    """s"""

    @classmethod
    def of(cls, message: Any) -> Goal:
        """Read a geometry_msgs/PoseStamped. Raises `InvalidRequest`."""
        return cls(message.header.frame_id, Pose.of(message.pose, "goal.pose"), stamp_of(message))

    def is_at(self, other: Goal | None) -> bool:
        """Return whether another goal is the same place in the same frame."""
        return other is not None and (self.frame_id, self.pose) == (other.frame_id, other.pose)

    def seen_from(self, frame_id: str, frames: Frames, *, at: float) -> Pose:
        """Return the pose in another frame at a time in s. Raises `InvalidRequest`."""
        if self.frame_id in ("", frame_id):
            return self.pose
        return frames.between(frame_id, self.frame_id, at=at) @ self.pose


def stamp_of(message: Any) -> float:
    """Return the s of a message's stamp."""
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def footprint_of(message: Any, *, robot: Pose | None = None) -> Array:
    """Return the corners [K,2] in m about the robot, from a geometry_msgs/PolygonStamped.

    Args:
        message: in the robot's frame, or where the robot stands, as Nav2 publishes it.
        robot: its pose in the message's frame; None if that is the robot's own.

    Raises:
        InvalidRequest: names `footprint` if there are no three finite corners.
    """
    corners = np.array([[point.x, point.y] for point in message.polygon.points], np.float64)
    if len(corners) < 3 or not np.isfinite(corners).all():
        came = f"{len(corners)} corners" if len(corners) < 3 else "numbers that are not"
        raise InvalidRequest(f"expected three or more finite corners, got {came}", "footprint")
    return corners if robot is None else robot.inverse.place(corners)


def speed_limit_of(message: Any, *, v_max: float) -> float | None:
    """Return the limit in m/s, or None for no limit.

    Args:
        message: a std_msgs/Float32 or Float64 in m/s, or a nav2_msgs/SpeedLimit; 0 is no limit.
        v_max: m/s, of which a SpeedLimit may be a percentage.

    Raises:
        InvalidRequest: names `speed_limit`.
    """
    if not hasattr(message, "percentage"):
        limit = number(float(message.data), "speed_limit", SPEED)
    elif message.percentage:
        limit = number(float(message.speed_limit), "speed_limit", PERCENT) * v_max / 100.0
    else:
        limit = number(float(message.speed_limit), "speed_limit", SPEED)
    return limit or None


@dataclass(frozen=True, eq=False)
class Tracks:
    """What moves, in a frame at a moment."""

    frame_id: str
    stamp: float
    """s"""
    obstacles: Obstacles

    def seen_from(self, frame_id: str, frames: Frames) -> Obstacles:
        """Return them in another frame. Raises `InvalidRequest`."""
        if self.frame_id in ("", frame_id):
            return self.obstacles
        transform = frames.between(frame_id, self.frame_id, at=self.stamp)
        moved = self.obstacles
        assert moved.velocity is not None
        return Obstacles.from_fields(
            {
                "position": transform.place(moved.position),
                "velocity": transform.turn(moved.velocity),
                "radius": moved.radius,
                "growth": moved.growth,
            }
        )


def tracks_of(message: Any, *, growth: float = 0.0) -> Tracks:
    """Read a sensor_msgs/PointCloud2 whose points are discs with the fields of TRACK_FIELDS.

    Args:
        message: one point a disc; each field is a number of any type, other fields are ignored.
        growth: m/s by which every radius grows.

    Raises:
        InvalidRequest: names `tracks`, if a field is missing, the data are too short or a number
            is out of range.
    """
    points = points_of(message)
    if missing := [name for name in TRACK_FIELDS if name not in points]:
        came = ", ".join(points) or "none"
        wanted = ", ".join(TRACK_FIELDS)
        raise InvalidRequest(
            f"expected points with {wanted}, got {came}; {missing[0]} is missing", "tracks"
        )
    x, y, vx, vy, radius = (points[name] for name in TRACK_FIELDS)
    obstacles = Obstacles.from_fields(
        {
            "position": np.column_stack([x, y]),
            "velocity": np.column_stack([vx, vy]),
            "radius": radius,
            "growth": growth,
        }
    )
    return Tracks(message.header.frame_id, stamp_of(message), obstacles)


def points_of(message: Any) -> dict[str, Array]:
    """Return a PointCloud2's scalar fields, each [M], by name. Raises `InvalidRequest`."""
    count, step = int(message.width) * int(message.height), int(message.point_step)
    data = np.frombuffer(bytes(message.data), np.uint8)
    rows = int(message.row_step) if message.height > 1 else step * int(message.width)
    if count and (step < 1 or len(data) < rows * int(message.height)):
        came = f"{len(data)} bytes"
        wanted = f"{message.height} rows of {rows} bytes"
        raise InvalidRequest(f"expected {wanted}, got {came}", "tracks.data")
    order = ">" if message.is_bigendian else "<"
    found: dict[str, Array] = {}
    for field in message.fields:
        kind = POINT_TYPES.get(int(field.datatype))
        if kind is None or field.count > 1:
            continue
        dtype = np.dtype(order + kind)
        if count and field.offset + dtype.itemsize > step:
            wanted = f"fields within the {step} bytes of a point"
            raise InvalidRequest(f"expected {wanted}, got {field.name} beyond", "tracks.fields")
        values = np.ndarray(
            (int(message.height), int(message.width)),
            dtype,
            buffer=data,
            offset=field.offset if count else 0,
            strides=(rows, step),
        )
        found[field.name] = values.reshape(-1).astype(np.float64)
    return found


def seconds_and_nanoseconds(seconds: float) -> tuple[int, int]:
    """Split a time in s into the two fields of a stamp."""
    whole = math.floor(seconds)
    nanoseconds = round(1e9 * (seconds - whole))
    return (whole + 1, 0) if nanoseconds == 10**9 else (whole, nanoseconds)
