"""Odometry: the robot's state at a moment, its acceleration, and where it will be soon.

nav_msgs/Odometry gives the pose in `header.frame_id` and the twist in `child_frame_id`, and no
acceleration; that is estimated from the twists of successive messages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.ranges import VELOCITY
from anchorflow_client.errors import InvalidRequest
from anchorflow_ros.frames import ORIGIN, Frames, Pose

Array = NDArray[np.float64]

SMOOTHING_S = 0.15
"""Time constant of the estimate of the acceleration."""
LONGEST_GAP_S = 0.5
"""Between two messages; after a longer gap the estimate begins anew."""
STRAIGHT = 1e-6
"""rad, the least turn that is driven as an arc."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotMotion:
    """The robot's pose at a moment, and its motion."""

    stamp: float
    """s"""
    frame_id: str
    """The frame of the pose."""
    base_frame: str
    """The robot's own frame."""
    pose: Pose
    twist: Array
    """[3] forward and left in m/s, turn rate in rad/s, in the robot's own frame."""
    acceleration: Array
    """[2] change of the first two in m/s^2, in the robot's own frame."""

    @property
    def speed(self) -> float:
        """m/s, whichever way."""
        return float(np.hypot(*self.twist[:2]))

    @property
    def velocity(self) -> Array:
        """[2] m/s, in the frame of the pose."""
        return self.pose.turn(self.twist[:2])

    def x_curr(self, *, a_max: float, with_heading: bool = False) -> Array:
        """Return [6] position, velocity, acceleration, or [9] with heading, in the pose's frame.

        The acceleration holds the centripetal one, and is no longer than `a_max` in m/s^2.
        """
        forward, left, turn_rate = self.twist
        felt = self.acceleration + turn_rate * np.array([-left, forward])
        felt = felt * min(1.0, a_max / max(float(np.hypot(*felt)), 1e-9))
        parts = [[self.pose.x, self.pose.y], self.velocity, self.pose.turn(felt)]
        if with_heading:
            turning = (self.pose.yaw, turn_rate, 0.0)
            parts = [[*part, more] for part, more in zip(parts, turning, strict=True)]
        return np.concatenate(parts)

    def after(self, seconds: float, twist: Array | None = None) -> RobotMotion:
        """Return the motion after a time at a constant twist, its own by default: along an arc."""
        held = self.twist if twist is None else np.asarray(twist, np.float64)
        turn = held[2] * seconds
        if abs(turn) < STRAIGHT:
            along, aside = seconds, 0.5 * turn * seconds
        else:
            along, aside = math.sin(turn) / held[2], (1.0 - math.cos(turn)) / held[2]
        forward, left = held[:2]
        step = Pose(along * forward - aside * left, aside * forward + along * left, turn)
        return replace(self, stamp=self.stamp + seconds, pose=self.pose @ step, twist=held)

    def seen_from(self, frame_id: str, frames: Frames) -> RobotMotion:
        """Return the same motion with its pose in another frame. Raises `InvalidRequest`."""
        if frame_id in (self.frame_id, ""):
            return self
        transform = frames.between(frame_id, self.frame_id, at=self.stamp)
        return replace(self, frame_id=frame_id, pose=transform @ self.pose)


class OdometryReader:
    """Reads the messages of one robot, in the order in which they come."""

    def __init__(self, *, base_frame: str = "", frames: Frames | None = None) -> None:
        """Set up the reader.

        Args:
            base_frame: the frame that is the robot; by default the `child_frame_id` of messages.
            frames: knows `base_frame` in the child frame, if they differ.
        """
        self._base_frame, self._frames = base_frame, frames
        self._last: RobotMotion | None = None

    def reset(self) -> None:
        self._last = None

    def read(self, message: Any) -> RobotMotion:
        """Read a nav_msgs/Odometry.

        Raises:
            InvalidRequest: names the field, such as odometry.pose.position, if a number is not
                finite, or if the base frame's place in the child frame is not known.
        """
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        pose = Pose.of(message.pose.pose, "odometry.pose")
        twist = message.twist.twist
        rates = np.array([twist.linear.x, twist.linear.y, twist.angular.z], np.float64)
        if not VELOCITY.holds_all(rates):
            came = ", ".join(f"{rate:g}" for rate in rates)
            raise InvalidRequest(f"expected numbers {VELOCITY}, got {came}", "odometry.twist")
        mount = self._mount(message.child_frame_id, stamp)
        if mount is not ORIGIN:
            pose = pose @ mount
            moved = rates[:2] + rates[2] * np.array([-mount.y, mount.x])
            rates[:2] = mount.inverse.turn(moved)
        self._last = RobotMotion(
            stamp=stamp,
            frame_id=message.header.frame_id,
            base_frame=self._base_frame or message.child_frame_id,
            pose=pose,
            twist=rates,
            acceleration=self._acceleration(stamp, rates),
        )
        return self._last

    def _mount(self, child_frame: str, stamp: float) -> Pose:
        """Return the robot's pose in the frame in which the twist is given."""
        if self._base_frame in ("", child_frame) or self._frames is None:
            return ORIGIN
        return self._frames.between(child_frame, self._base_frame, at=stamp)

    def _acceleration(self, stamp: float, rates: Array) -> Array:
        """Return [2] m/s^2, smoothed over some messages."""
        last = self._last
        if last is None or not 0.0 <= stamp - last.stamp <= LONGEST_GAP_S:
            return np.zeros(2)
        gap = stamp - last.stamp
        if gap == 0.0:
            return last.acceleration
        share = 1.0 - math.exp(-gap / SMOOTHING_S)
        measured = (rates[:2] - last.twist[:2]) / gap
        return last.acceleration + share * (measured - last.acceleration)
