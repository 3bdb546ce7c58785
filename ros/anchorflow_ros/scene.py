"""Collects the messages of a robot, and makes of the newest ones the scene to plan in."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import CostMap, Obstacles
from anchorflow_client.errors import InvalidRequest
from anchorflow_control import Robot
from anchorflow_ros.faults import WARN, Fault, Stopped
from anchorflow_ros.frames import Frames, Pose
from anchorflow_ros.inputs import Goal, Tracks, footprint_of, speed_limit_of, tracks_of
from anchorflow_ros.maps import MapReader
from anchorflow_ros.odometry import OdometryReader, RobotMotion
from anchorflow_ros.parameters import Settings, robot_of

Array = NDArray[np.float64]

FUTURE_S = 0.1
"""A stamp may be ahead of the node's clock by this much."""
SAME_CORNERS = 1e-3
"""m by which a footprint may differ from the present one and count as the same."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a plan needs, at one moment and in the map's frame."""

    frame_id: str
    cost_map: CostMap
    motion: RobotMotion
    goal: Pose
    obstacles: Obstacles | None
    obstacles_age_s: float

    @property
    def goal_distance(self) -> float:
        """m from the robot to the goal."""
        here = self.motion.pose
        return math.hypot(self.goal.x - here.x, self.goal.y - here.y)


class SceneReader:
    """Holds the newest good message of each topic, and why the last bad one was refused."""

    def __init__(self, settings: Settings, frames: Frames) -> None:
        self.maps = MapReader(settings.meaning)
        self.goal: Goal | None = None
        self.goals_sent = 0
        self.robot: Robot = settings.robot
        """Its body is that of the last footprint message, if there was one."""
        self.speed_limit: float | None = None
        """m/s"""
        self.refused: dict[str, str] = {}
        """The reason by part, until a good message arrives."""
        self._settings, self._frames = settings, frames
        self._odometry = OdometryReader(base_frame=settings["frames.base"], frames=frames)
        self._motion: RobotMotion | None = None
        self._tracks: Tracks | None = None

    @property
    def base_frame(self) -> str:
        """The robot's own frame, by the parameter or the last odometry."""
        named: str = self._settings["frames.base"]
        return named or (self._motion.base_frame if self._motion is not None else "")

    def on_map(self, message: Any, *, now: float) -> None:
        """Take a nav_msgs/OccupancyGrid or nav2_msgs/Costmap that arrives at a time in s."""
        with self._reading("map"):
            self.maps.on_grid(message, now=now)

    def on_map_update(self, message: Any, *, now: float) -> None:
        """Take an update of the map; one that is refused leaves the map as it was."""
        with self._reading("map"):
            self.maps.on_update(message, now=now)

    def on_odometry(self, message: Any) -> None:
        """Take a nav_msgs/Odometry; after one that is refused the robot's state is unknown."""
        self._motion = None
        with self._reading("odometry"):
            self._motion = self._odometry.read(message)

    def on_goal(self, message: Any) -> None:
        """Take a geometry_msgs/PoseStamped; the same goal again is the one that is held."""
        goal = None
        with self._reading("goal"):
            goal = Goal.of(message)
        self.goals_sent += 1
        if goal is None or not goal.is_at(self.goal):
            self.goal = goal

    def cancel(self) -> None:
        self.goal = None
        self.refused.pop("goal", None)

    def on_tracks(self, message: Any) -> None:
        """Take a sensor_msgs/PointCloud2 of discs that move."""
        with self._reading("tracks"):
            self._tracks = tracks_of(message, growth=self._settings["tracks.growth"])

    def on_footprint(self, message: Any) -> None:
        """Take a geometry_msgs/PolygonStamped; the last good one stays in use."""
        with self._reading("footprint"):
            corners = footprint_of(message, robot=self._robot_in(message.header.frame_id))
            known = self.robot.footprint
            same = known is not None and np.shape(known) == corners.shape
            if not same or not np.allclose(np.asarray(known), corners, atol=SAME_CORNERS):
                self.robot = robot_of(self._settings.values, corners)

    def on_speed_limit(self, message: Any) -> None:
        """Take a std_msgs/Float32 or a nav2_msgs/SpeedLimit."""
        with self._reading("speed limit"):
            self.speed_limit = speed_limit_of(message, v_max=self.robot.v_max)

    def begin_anew(self, now: float) -> None:
        """Forget what was stamped by a clock that has jumped to `now`; map and goal stay."""
        self._odometry.reset()
        self._motion = self._tracks = None
        self.maps.changed_at = now

    def warnings(self) -> Iterator[Fault]:
        """Yield what was refused and does not stop the robot."""
        for part, text in self.refused.items():
            yield Fault(part, WARN, text)

    def scene(self, now: float) -> Scene:
        """Return the scene at a time of the messages' clock. Raises `Stopped`."""
        motion, goal = self._motion, self.goal
        if motion is None:
            raise Stopped("odometry", self.refused.get("odometry", "no message has arrived"))
        if goal is None:
            raise Stopped("goal", self.refused.get("goal", "no message has arrived"))
        age = self._age_of(motion, now)
        frame_id = self._frame_of_map(now) or motion.frame_id
        try:
            here = motion.seen_from(frame_id, self._frames).after(age)
            aim = goal.seen_from(frame_id, self._frames, at=now)
            obstacles, obstacles_age = self._obstacles(frame_id, now)
        except InvalidRequest as error:
            raise Stopped("frames", error.message) from error
        place = np.array([here.pose.x, here.pose.y])
        try:
            cost_map = self.maps.cost_map(place)
        except InvalidRequest as error:
            raise Stopped("map", error.message) from error
        self._check_on_map(cost_map, place, aim)
        return Scene(frame_id, cost_map, here, aim, obstacles, obstacles_age)

    def _frame_of_map(self, now: float) -> str | None:
        if (grid := self.maps.grid) is None:
            raise Stopped("map", self.refused.get("map", "no message has arrived"))
        limit, silence = self._settings["map.timeout_s"], now - self.maps.changed_at
        if limit and silence > limit:
            raise Stopped("map", f"no message for {silence:.2f} s; {limit:g} s are allowed")
        return grid.frame_id

    def _age_of(self, motion: RobotMotion, now: float) -> float:
        """Return the s since the odometry was measured."""
        age, limit = now - motion.stamp, self._settings["odometry.timeout_s"]
        if age > limit:
            text = f"the last message is {age:.2f} s old; {limit:g} s are allowed"
            raise Stopped("odometry", text)
        if age < -FUTURE_S:
            text = f"its stamp is {-age:.2f} s ahead of the node's clock; compare the two clocks"
            raise Stopped("odometry", text)
        return max(age, 0.0)

    def _check_on_map(self, cost_map: CostMap, place: Array, goal: Pose) -> None:
        if not cost_map.contains(*place.tolist()):
            raise Stopped("odometry", f"the robot at {_at(*place)} is off the map")
        if self._settings["goal.beyond_map"] == "approach" or self._settings.meaning.window_m:
            return
        if not cost_map.contains(goal.x, goal.y):
            low, high = cost_map.extent
            text = f"{_at(goal.x, goal.y)} is off the map, from {_at(*low)} to {_at(*high)}"
            raise Stopped("goal", text)

    def _obstacles(self, frame_id: str, now: float) -> tuple[Obstacles | None, float]:
        """Return the tracks in a frame and their age in s; none if they are too old."""
        if (tracks := self._tracks) is None:
            return None, 0.0
        age, limit = now - tracks.stamp, self._settings["tracks.timeout_s"]
        if age > limit:
            self.refused["tracks"] = f"the last message is {age:.2f} s old: nobody is expected"
            return None, 0.0
        return tracks.seen_from(frame_id, self._frames), max(age, 0.0)

    def _robot_in(self, frame_id: str) -> Pose | None:
        """Return the robot's pose in a frame; None if the frame is its own."""
        motion = self._motion
        if frame_id in ("", self._settings["frames.base"]):
            return None
        if motion is None:
            message = f"expected the robot's own frame before any odometry, got {frame_id!r}"
            raise InvalidRequest(message, "footprint.frame_id")
        if frame_id == motion.base_frame:
            return None
        return motion.seen_from(frame_id, self._frames).pose

    @contextmanager
    def _reading(self, part: str) -> Iterator[None]:
        """Note why a message of a part is refused, until a good one arrives."""
        try:
            yield
        except InvalidRequest as error:
            self.refused[part] = error.message
        else:
            self.refused.pop(part, None)


def _at(x: float, y: float) -> str:
    return f"({x:.2f}, {y:.2f}) m"
