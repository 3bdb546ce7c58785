"""The node's parameters: one table, from which the node, its YAML file and the page are checked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from anchorflow_client.contract.checks import Interval, choice, expected, number
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.planner import PlannerConfig
from anchorflow_control import MppiConfig, Robot
from anchorflow_ros.maps import MapMeaning

SECONDS = Interval(0.0, 3600.0, "s")
RATE = Interval(1.0, 1000.0, "Hz")
DISTANCE = Interval(0.0, 100.0, "m")
GROWTH = Interval(0.0, 100.0, "m/s")
MAP_TYPES = ("occupancy_grid", "costmap")
BEYOND = ("refuse", "approach")
IN_PROCESS = "in process"

PARAMETERS: dict[str, tuple[Any, str]] = {
    "service": (
        IN_PROCESS,
        "Who plans: 'in process', the URL of a service, or a zenoh endpoint such as "
        "tcp/127.0.0.1:7447.",
    ),
    "service.bundle": (
        "",
        "Folder of the bundle that plans in process; by default its own.",
    ),
    "service.model": ("", "Model of the service; by default its own."),
    "service.num_samples": (16, "Anchors of a request."),
    "service.options": (
        '{"sampler": {"method": "midpoint", "schedule": {"uniform": 2}}}',
        "Further fields of each request, as JSON; the default samples in four evaluations.",
    ),
    "service.period_s": (0.1, "Shortest time between two requests."),
    "service.lead_s": (
        0.1,
        "Time ahead of each request's start: about the time until its answer is there.",
    ),
    "service.silence_s": (0.25, "Time without an answer after which the robot brakes."),
    "service.max_age_s": (1.0, "Age at which a plan is no longer followed; time for an answer."),
    "rate_hz": (20.0, "Commands per second."),
    "autostart": (True, "Configure and activate at the start, without a lifecycle manager."),
    "robot.kind": ("differential", "differential, omni or ackermann."),
    "robot.radius": (0.25, "m; of the disc. Not used with a footprint."),
    "robot.footprint": ("", "Corners of a convex body in m, as Nav2 writes them: [[x, y], …]."),
    "robot.v_max": (1.0, "m/s."),
    "robot.a_max": (1.5, "m/s²."),
    "robot.omega_max": (1.5, "rad/s."),
    "robot.alpha_max": (4.0, "rad/s²."),
    "robot.min_turning_radius": (0.0, "m; above 0 for ackermann."),
    "robot.reverse": (False, "Whether the robot may drive backwards."),
    "robot.delay_s": (0.05, "Time from a tick until the robot obeys its command."),
    "robot.margin": (0.05, "m beyond the body that plan and controller keep from obstacles."),
    "robot.plan_poses": (
        False,
        "Send footprint and kinematics with each request, so that anchors have headings.",
    ),
    "goal.tolerance": (0.25, "m from the goal at which the robot has arrived and stops."),
    "goal.beyond_map": (
        "refuse",
        "refuse: brake at a goal off the map; approach: drive towards it, for a rolling window.",
    ),
    "frames.base": ("", "The robot's frame; by default the child frame of the odometry."),
    "frames.transforms": (
        [""],
        "Transforms that do not change: 'PARENT CHILD X Y YAW' each, in m and rad. tf2 is used "
        "as well if the node finds it.",
    ),
    "map.type": ("occupancy_grid", "occupancy_grid, or costmap for nav2_msgs/Costmap."),
    "map.inflated": (True, "True: a cost map as Nav2 publishes it. False: probabilities, by SLAM."),
    "map.inscribed_is_obstacle": (False, "Cost 99 is an obstacle: for a robot of radius 0."),
    "map.unknown": ("obstacle", "Unknown space: obstacle, free, or a soft cost from 0 to 1."),
    "map.window_m": (0.0, "Side of the window round the robot in m; 0: the whole map."),
    "map.timeout_s": (0.0, "Age of the map at which the robot brakes; 0: never, for a fixed map."),
    "odometry.timeout_s": (0.3, "Age of the odometry at which the robot brakes."),
    "tracks.timeout_s": (1.0, "Age at which tracks are dropped, with a warning."),
    "tracks.growth": (0.1, "m/s by which the radius of a track grows: how sure its velocity is."),
    "clock.jump_s": (1.0, "Jump of the clock at which everything read before is forgotten."),
    "clock.stands_s": (0.3, "Real time in which the clock of the stamps has to move."),
    "topics.map": ("map", "nav_msgs/OccupancyGrid or nav2_msgs/Costmap."),
    "topics.map_updates": ("map_updates", "Its updates, if their package is installed."),
    "topics.odometry": ("odom", "nav_msgs/Odometry."),
    "topics.goal": ("goal_pose", "geometry_msgs/PoseStamped."),
    "topics.footprint": (
        "footprint",
        "geometry_msgs/PolygonStamped; replaces the parameters.",
    ),
    "topics.tracks": ("tracks", "sensor_msgs/PointCloud2 with x, y, vx, vy, radius."),
    "topics.speed_limit": ("speed_limit", "std_msgs/Float32 in m/s, or nav2_msgs/SpeedLimit."),
    "topics.command": ("cmd_vel", "geometry_msgs/TwistStamped, published."),
    "topics.path": ("plan", "nav_msgs/Path of the best anchor, published."),
    "topics.candidates": ("candidates", "visualization_msgs/MarkerArray, published."),
    "topics.trajectory": ("trajectory", "trajectory_msgs/MultiDOFJointTrajectory, published."),
    "topics.diagnostics": ("/diagnostics", "diagnostic_msgs/DiagnosticArray, published."),
}
"""Default and meaning by name; the type of the default is the parameter's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Settings:
    """The parameters, checked, in the form in which the node's parts take them."""

    values: Mapping[str, Any]
    """Each value by its name in PARAMETERS."""
    robot: Robot
    controller: MppiConfig
    planner: PlannerConfig
    meaning: MapMeaning
    options: Mapping[str, Any]
    """Fields of each request, beside map, state, goal and robot."""
    transforms: tuple[str, ...]

    @classmethod
    def of(cls, given: Mapping[str, Any] | None = None) -> Settings:
        """Check the parameters; others have their defaults. Raises `InvalidRequest`."""
        for name in given or {}:
            choice(name, "parameter", tuple(PARAMETERS))
        values = {name: default for name, (default, _) in PARAMETERS.items()} | dict(given or {})
        _check(values)
        robot, margin = robot_of(values), values["robot.margin"]
        try:
            planner = PlannerConfig(
                margin_m=margin,
                period_ms=1e3 * values["service.period_s"],
                max_age_ms=1e3 * values["service.max_age_s"],
                through_speed=robot.v_max,
            )
            controller = MppiConfig(margin=margin)
        except ValueError as error:
            raise InvalidRequest(str(error), "parameters") from error
        return cls(
            values=values,
            robot=robot,
            controller=controller,
            planner=planner,
            meaning=MapMeaning(
                **{
                    name: values[f"map.{name}"]
                    for name in ("inflated", "inscribed_is_obstacle", "unknown", "window_m")
                }
            ),
            options=_options(values),
            transforms=tuple(filter(None, values["frames.transforms"])),
        )

    @property
    def tick_s(self) -> float:
        """s between two commands."""
        return 1.0 / self.values["rate_hz"]

    def __getitem__(self, name: str) -> Any:
        return self.values[name]


def robot_of(values: Mapping[str, Any], footprint: Any = None) -> Robot:
    """Return the robot, with another footprint [K,2] if one is given. Raises `InvalidRequest`."""
    if footprint is None and values["robot.footprint"]:
        footprint = _json(values["robot.footprint"], "robot.footprint", "a list of corners")
    names = ("kind", "v_max", "a_max", "omega_max", "alpha_max", "min_turning_radius", "reverse")
    try:
        return Robot(
            radius=values["robot.radius"] if footprint is None else None,
            footprint=footprint,
            **{name: values[f"robot.{name}"] for name in names},
        )
    except InvalidRequest as error:
        name = (error.field or "").rpartition(".")[2]  # its wheels are a group of their own
        message = error.message.removeprefix(f"{error.field}: ")
        raise InvalidRequest(message, f"robot.{name}") from error


def _check(values: Mapping[str, Any]) -> None:
    number(values["rate_hz"], "rate_hz", RATE)
    number(values["goal.tolerance"], "goal.tolerance", DISTANCE)
    number(values["tracks.growth"], "tracks.growth", GROWTH)
    for name in values:
        if name.endswith("_s"):
            number(values[name], name, SECONDS)
    choice(values["map.type"], "map.type", MAP_TYPES)
    choice(values["goal.beyond_map"], "goal.beyond_map", BEYOND)


def _options(values: Mapping[str, Any]) -> dict[str, Any]:
    options = _json(values["service.options"], "service.options", "an object of request fields")
    if not isinstance(options, dict):
        raise expected("service.options", "an object of request fields", options)
    if values["robot.plan_poses"]:  # poses are searched, not sampled; a goal has no heading
        options = {"goal_tolerance": {"position": 0.0}, **options}
        options.pop("sampler", None)
    if values["service.model"]:
        options = {"model": values["service.model"], **options}
    return {"num_samples": values["service.num_samples"], **options}


def _json(text: str, name: str, wanted: str) -> Any:
    try:
        return json.loads(text)
    except ValueError as error:
        raise InvalidRequest(f"expected {wanted} as JSON, got {text!r}", name) from error
