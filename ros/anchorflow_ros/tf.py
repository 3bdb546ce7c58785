"""Transforms by tf2 where a robot's ROS has it; the wheels of ROS have none."""

from __future__ import annotations

import importlib
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

from anchorflow_client.errors import InvalidRequest
from anchorflow_ros.frames import Frames, Pose, StaticFrames
from anchorflow_ros.inputs import seconds_and_nanoseconds

NO_WAIT = Duration(seconds=0)


class TfFrames:
    """Static transforms first, then tf2's newest where the moment's own is not known yet."""

    def __init__(self, node: Node, static: StaticFrames, tf2_ros: Any) -> None:
        self._static, self._tf2_ros = static, tf2_ros
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def between(self, target: str, source: str, *, at: float) -> Pose:
        try:
            return self._static.between(target, source)
        except InvalidRequest:
            pass
        seconds, nanoseconds = seconds_and_nanoseconds(at)
        moment = Time(seconds=seconds, nanoseconds=nanoseconds)
        try:
            if not self._buffer.can_transform(target, source, moment, NO_WAIT):
                moment = Time()
            transform = self._buffer.lookup_transform(target, source, moment, NO_WAIT).transform
        except self._tf2_ros.TransformException as error:
            raise InvalidRequest(f"expected a transform by tf2: {error}", "frames") from error
        return Pose.of(_PoseFields(transform), "frames")


class _PoseFields:
    """A geometry_msgs/Transform with the names of a geometry_msgs/Pose."""

    def __init__(self, transform: Any) -> None:
        self.position, self.orientation = transform.translation, transform.rotation


def frames_of(node: Node, static: StaticFrames) -> Frames:
    """Return transforms by tf2 if it can be imported, else the static ones alone."""
    try:
        tf2_ros = importlib.import_module("tf2_ros")
    except ImportError:
        node.get_logger().info("no tf2 here: transforms are those of frames.transforms")
        return static
    return TfFrames(node, static, tf2_ros)
