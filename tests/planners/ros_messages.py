"""Makes the messages that a robot with ROS 2 publishes, of ROS's own classes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point32, PolygonStamped, Pose, PoseStamped, Quaternion
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header


def header(stamp: float = 10.0, frame_id: str = "map") -> Header:
    nanoseconds = round(1e9 * stamp)
    time = Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return Header(stamp=time, frame_id=frame_id)


def pose(x: float, y: float, yaw: float = 0.0) -> Pose:
    made = Pose(orientation=Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2)))
    made.position.x, made.position.y = float(x), float(y)
    return made


class Messages:
    """Makes the messages that a robot publishes."""

    def odometry(
        self,
        x: float,
        y: float,
        yaw: float = 0.0,
        *,
        twist: tuple[float, float, float] = (0.0, 0.0, 0.0),
        stamp: float = 10.0,
        frame_id: str = "map",
        child: str = "base_link",
    ) -> Odometry:
        made = Odometry(header=header(stamp, frame_id), child_frame_id=child)
        made.pose.pose = pose(x, y, yaw)
        made.twist.twist.linear.x, made.twist.twist.linear.y = twist[:2]
        made.twist.twist.angular.z = twist[2]
        return made

    def goal(
        self, x: float, y: float, yaw: float = 0.0, *, frame_id: str = "map", stamp: float = 10.0
    ) -> PoseStamped:
        return PoseStamped(header=header(stamp, frame_id), pose=pose(x, y, yaw))

    def grid(
        self,
        percent: Any,
        *,
        resolution: float = 0.1,
        origin: tuple[float, float] = (0.0, 0.0),
        stamp: float = 10.0,
        frame_id: str = "map",
    ) -> OccupancyGrid:
        cells = np.asarray(percent, np.int8)
        made = OccupancyGrid(header=header(stamp, frame_id))
        made.info.height, made.info.width = cells.shape
        made.info.resolution, made.info.origin = resolution, pose(*origin)
        made.data = cells.ravel().tolist()
        return made

    def polygon(self, corners: Any, *, frame_id: str = "base_link") -> PolygonStamped:
        made = PolygonStamped(header=header(10.0, frame_id))
        made.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
        return made

    def tracks(
        self,
        rows: Any,
        names: tuple[str, ...] = ("x", "y", "vx", "vy", "radius"),
        *,
        stamp: float = 10.0,
        frame_id: str = "map",
    ) -> PointCloud2:
        values = np.asarray(rows, np.float32).reshape(-1, len(names))
        made = PointCloud2(header=header(stamp, frame_id), height=1, width=len(values))
        made.fields = [
            PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate(names)
        ]
        made.point_step = 4 * len(names)
        made.row_step = made.point_step * made.width
        made.data = values.tobytes()
        return made
