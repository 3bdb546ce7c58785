"""Poses in the plane, and the transforms between the frames in which messages are given.

frames = StaticFrames(["map odom 1.0 2.0 0.5"])  # parent, child, x and y in m, yaw in rad
in_map = frames.between("map", "odom", at=stamp) @ Pose.of(message.pose.pose, "odometry.pose")
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_client.contract.ranges import COORDINATE
from anchorflow_client.errors import InvalidRequest

Array = NDArray[np.float64]

UNIT_LENGTH = 0.1
"""The length of a quaternion may differ from 1 by this much."""
MOVING = 0.05
"""m/s; slower anchors give no heading, and keep the last one."""


@dataclass(frozen=True)
class Pose:
    """A pose in the plane, or the transform from that frame into the one in which it is given."""

    x: float
    """m"""
    y: float
    """m"""
    yaw: float = 0.0
    """rad"""

    @classmethod
    def of(cls, pose: Any, field: str) -> Pose:
        """Read a geometry_msgs/Pose. Raises `InvalidRequest`."""
        x, y = float(pose.position.x), float(pose.position.y)
        if not (COORDINATE.holds(x) and COORDINATE.holds(y)):
            message = f"expected numbers {COORDINATE}, got {x:g}, {y:g}"
            raise InvalidRequest(message, f"{field}.position")
        return cls(x, y, yaw_of(pose.orientation, f"{field}.orientation"))

    def __matmul__(self, inner: Pose) -> Pose:
        """Return `inner`, which is given in this pose's frame, in the frame of this pose."""
        x, y = self.place([inner.x, inner.y]).tolist()
        return Pose(x, y, math.remainder(self.yaw + inner.yaw, math.tau))

    @property
    def inverse(self) -> Pose:
        """Return the transform the other way."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Pose(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.yaw)

    def turn(self, vectors: ArrayLike) -> Array:
        """Return vectors [...,2] of this pose's frame as seen from the outer frame."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return np.asarray(vectors, np.float64) @ np.array([[cos, sin], [-sin, cos]])

    def place(self, points: ArrayLike) -> Array:
        """Return points [...,2] m of this pose's frame in the outer frame."""
        return self.turn(points) + np.array([self.x, self.y])


ORIGIN = Pose(0.0, 0.0, 0.0)


def yaw_of(orientation: Any, field: str) -> float:
    """Return the rad of a geometry_msgs/Quaternion, which may tilt a little.

    Raises `InvalidRequest` if its length is not 1, as in a message that was never filled.
    """
    x, y, z, w = (float(getattr(orientation, axis)) for axis in "xyzw")
    if not abs(math.hypot(x, y, z, w) - 1.0) <= UNIT_LENGTH:
        raise InvalidRequest(f"expected a unit quaternion, got [{x:g}, {y:g}, {z:g}, {w:g}]", field)
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


class Frames(Protocol):
    """Transforms between frames."""

    def between(self, target: str, source: str, *, at: float) -> Pose:
        """Return the transform of `source` into `target` at `at` s. Raises `InvalidRequest`."""
        ...


class StaticFrames:
    """Transforms that are parameters and never change."""

    def __init__(self, transforms: Iterable[str] = ()) -> None:
        """Read texts of parent, child, x and y in m, yaw in rad. Raises `InvalidRequest`."""
        self._edges: dict[str, dict[str, Pose]] = {}
        for text in transforms:
            parent, child, pose = _read_transform(text)
            self._edges.setdefault(parent, {})[child] = pose
            self._edges.setdefault(child, {})[parent] = pose.inverse

    def between(self, target: str, source: str, *, at: float = 0.0) -> Pose:
        del at
        reached, waiting = {target: ORIGIN}, deque([target])
        while waiting and source not in reached:
            frame = waiting.popleft()
            for other, pose in self._edges.get(frame, {}).items():
                if other not in reached:
                    reached[other] = reached[frame] @ pose
                    waiting.append(other)
        if source not in reached:
            raise InvalidRequest(
                f"expected a transform from {source!r} to {target!r}, got none", "frames"
            )
        return reached[source]


def _read_transform(text: str) -> tuple[str, str, Pose]:
    parts = text.split()
    try:
        parent, child, *numbers = parts
        x, y, yaw = map(float, numbers)
    except ValueError as error:
        wanted = "'PARENT CHILD X Y YAW' in m and rad"
        raise InvalidRequest(f"expected {wanted}, got {text!r}", "frames.transforms") from error
    if not all(map(math.isfinite, (x, y, yaw))) or parent == child:
        wanted = "two frames and finite numbers"
        raise InvalidRequest(f"expected {wanted}, got {text!r}", "frames.transforms")
    return parent, child, Pose(x, y, yaw)


def poses_of(batch: AnchorBatch, index: int) -> Array:
    """Return [T,3] x, y, heading of an anchor; without headings those of the velocity."""
    path = batch.trajectories[index].astype(np.float64)
    if path.shape[1] > 2:
        return path
    velocity = batch.velocities[index, :, :2].astype(np.float64)
    moving = np.hypot(*velocity.T) > MOVING
    if not moving.any():
        return np.column_stack([path, np.zeros(len(path))])
    last = np.maximum.accumulate(np.where(moving, np.arange(len(path)), -1))
    last[last < 0] = int(moving.argmax())
    return np.column_stack([path, np.arctan2(velocity[last, 1], velocity[last, 0])])
