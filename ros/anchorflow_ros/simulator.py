"""A simulated robot with lidar, as a ROS 2 process of its own beside the node.

    python -m anchorflow_ros.simulator                        # a corridor with posts
    python -m anchorflow_ros.simulator --map MAP --start X Y YAW --goal X Y

It publishes `odom`, `scan`, `map` and the world's `goal_pose`, obeys `cmd_vel`, and ends when the
robot has arrived, touches something, or takes too long; the last line it prints is a JSON object.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from array import array
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Quaternion, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import LaserScan

from anchorflow_benchmarks.closed_loop.lidar_mapping import Scan
from anchorflow_benchmarks.closed_loop.worlds import World, load_worlds
from anchorflow_client.errors import AnchorFlowError
from anchorflow_ros.frames import Pose
from anchorflow_ros.node import LATCHED, NEWEST, SENSOR
from anchorflow_ros.outputs import header_of
from anchorflow_ros.simulation import Base, Eyes, Inflation, whole_grid, world_of_map

MAP, BASE = "map", "base_link"
MOVE_S, SCAN_S, GOAL_S = 0.02, 0.1, 1.0
LONGEST_REAL_STEP_S = 0.1
LONGEST_STEP_S = 0.01
"""The longest step of the motion; a late timer takes several."""
PATIENCE_S = 0.1
COMMAND_S = 0.5
"""Age of a command after which the base stops by itself."""
STANDS = 0.05
"""m/s and rad/s, below which a robot at its goal has arrived."""
DEFAULT_INFLATION = Inflation()
OWN_DISC = 0.8
"""Share of the robot's radius; what the lidar sees within it is noise."""


@dataclass(frozen=True, kw_only=True)
class SimulatorOptions:
    """The world, the robot, and how they are published."""

    world: World
    radius: float = 0.25
    """m, of the robot's disc."""
    tolerance: float = 0.3
    """m from the goal at which a standing robot has arrived."""
    limit_s: float = 90.0
    whole_map: bool = False
    """Publish the whole world as one grid once, instead of what the lidar has seen."""
    inflation: Inflation = DEFAULT_INFLATION
    speed: float | None = None
    """Simulated seconds in one of real time, by the topic `clock`; None: real time without it.
    The clock waits for commands that are later than PATIENCE_S, as on a machine that is busy."""


class Simulator(Node):
    """One robot in one world."""

    def __init__(self, options: SimulatorOptions, **node: Any) -> None:
        super().__init__("simulator", **node)
        self.options, world = options, options.world
        self.result: dict[str, Any] | None = None
        x, y, yaw = world.start.tolist()
        self._base, self._eyes = Base(Pose(x, y, yaw)), Eyes(world)
        self._stepped_at = time.monotonic()
        self._time = 0.0 if options.speed is not None else time.time()
        self._began, self._due = self._time, {"scan": self._time, "goal": self._time}
        self._command, self._commands, self._commanded_at = (0.0, 0.0), 0, -math.inf
        self._first_command_at: float | None = None
        self._clearance = world.clearance(world.start[:2], options.radius)
        self._length = 0.0
        self._clock_topic = self.create_publisher(ClockMessage, "/clock", NEWEST)
        self._odometry = self.create_publisher(Odometry, "odom", SENSOR)
        self._scans = self.create_publisher(LaserScan, "scan", SENSOR)
        self._maps = self.create_publisher(OccupancyGrid, "map", LATCHED)
        self._goals = self.create_publisher(PoseStamped, "goal_pose", NEWEST)
        self.create_subscription(TwistStamped, "cmd_vel", self._on_command, NEWEST)
        if options.whole_map:
            cells, origin = whole_grid(world, self._eyes.local.resolution)
            self._publish_map(cells, origin)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(MOVE_S / (options.speed or 1.0), self._step, clock=steady)

    def _step(self) -> None:
        """Advance to the present, and publish what is due."""
        now = self._present()
        self._move(now)
        if self.options.speed is not None:
            self._clock_topic.publish(ClockMessage(clock=header_of(now, "").stamp))
        self._publish_odometry()
        for name, period, publish in (
            ("scan", SCAN_S, self._look),
            ("goal", GOAL_S, self._publish_goal),
        ):
            if now >= self._due[name]:
                self._due[name] = now + period
                publish()
        self._check_end()

    def _present(self) -> float:
        """Return the s up to which the world is simulated now."""
        if (speed := self.options.speed) is None:
            return time.time()
        steady = time.monotonic()
        now = self._time + speed * min(steady - self._stepped_at, LONGEST_REAL_STEP_S)
        self._stepped_at = steady
        if not any(self._command):
            return now
        return max(self._time, min(now, self._commanded_at + PATIENCE_S))

    def _on_command(self, message: TwistStamped) -> None:
        if self._first_command_at is None:
            self._first_command_at = self._time
        self._commands += 1
        self._commanded_at = self._time
        self._command = message.twist.linear.x, message.twist.angular.z

    def _move(self, now: float) -> None:
        options = self.options
        v, w = self._command if now - self._commanded_at < COMMAND_S else (0.0, 0.0)
        while self._time < now:
            dt = min(now - self._time, LONGEST_STEP_S)
            before = self._place()
            self._base.step(v, w, dt)
            self._time += dt
            place = self._place()
            self._length += float(np.linalg.norm(place - before))
            clearance = options.world.clearance(place, options.radius)
            self._clearance = min(self._clearance, clearance)

    def _check_end(self) -> None:
        options = self.options
        away = float(np.linalg.norm(self._place() - options.world.goal))
        if self._clearance < 0.0:
            self._end("contact")
        elif away <= options.tolerance and max(abs(self._base.v), abs(self._base.w)) < STANDS:
            self._end("goal")
        elif self._time - self._began > options.limit_s:
            self._end("timeout")

    def _end(self, end: str) -> None:
        began = self._began if self._first_command_at is None else self._first_command_at
        lasted = self._time - began
        self.result = {
            "world": self.options.world.name,
            "end": end,
            "time_s": round(lasted, 2),
            "length_m": round(self._length, 2),
            "clearance_m": round(self._clearance, 3),
            "commands_hz": round(self._commands / max(lasted, 1e-9), 1),
        }

    def _place(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.array([self._base.pose.x, self._base.pose.y])

    def _publish_odometry(self) -> None:
        message = Odometry(header=header_of(self._time, MAP), child_frame_id=BASE)
        _write_pose(message.pose.pose, self._base.pose)
        message.twist.twist.linear.x, message.twist.twist.angular.z = self._base.v, self._base.w
        self._odometry.publish(message)

    def _look(self) -> None:
        """Scan; publish the scan and, unless there is a whole map, what has been seen so far."""
        scan = self._eyes.scan(self._base.pose)
        self._scans.publish(self._laser_scan(scan))
        if not self.options.whole_map:
            local = self._eyes.local
            seen = local.occupied_beyond(self._place(), OWN_DISC * self.options.radius)
            self._publish_map(seen, local.origin)

    def _laser_scan(self, scan: Scan) -> LaserScan:
        lidar = self._eyes.lidar
        step = float(scan.bearings[1] - scan.bearings[0])
        return LaserScan(
            header=header_of(self._time, BASE),
            angle_min=float(scan.bearings[0]),
            angle_max=float(scan.bearings[-1]),
            angle_increment=step,
            range_max=lidar.max_range,
            ranges=array("f", np.where(scan.hits, scan.ranges, np.inf).astype(np.float32)),
        )

    def _publish_map(self, occupied: Any, origin: Any) -> None:
        resolution = self._eyes.local.resolution
        message = OccupancyGrid(header=header_of(self._time, MAP))
        message.info.height, message.info.width = occupied.shape
        message.info.resolution = resolution
        _write_pose(message.info.origin, Pose(*np.asarray(origin, np.float64).tolist()))
        percent = self.options.inflation.percent(occupied, resolution)
        message.data = array("b", percent.tobytes())
        self._maps.publish(message)

    def _publish_goal(self) -> None:
        message = PoseStamped(header=header_of(self._time, MAP))
        _write_pose(message.pose, Pose(*self.options.world.goal.tolist()))
        self._goals.publish(message)


def _write_pose(message: Any, pose: Pose) -> None:
    message.position.x, message.position.y = pose.x, pose.y
    message.orientation = Quaternion(z=math.sin(0.5 * pose.yaw), w=math.cos(0.5 * pose.yaw))


def parse(arguments: Sequence[str] | None = None) -> tuple[SimulatorOptions, list[str]]:
    """Return the options, and the arguments that are ROS's."""
    parser = argparse.ArgumentParser(prog="python -m anchorflow_ros.simulator")
    parser.add_argument("--worlds", default="drawn:1:0", help="as `anchorflow bench closed-loop`")
    parser.add_argument("--world", type=int, default=0, help="index of the world")
    parser.add_argument("--map", type=Path, help="YAML file of a map server, instead of a world")
    parser.add_argument("--start", type=float, nargs=3, metavar=("X", "Y", "YAW"))
    parser.add_argument("--goal", type=float, nargs=2, metavar=("X", "Y"))
    parser.add_argument("--whole-map", action="store_true", help="publish the world as one grid")
    parser.add_argument("--inflation", type=float, default=Inflation.radius, help="m; 0: none")
    parser.add_argument("--radius", type=float, default=SimulatorOptions.radius, help="m")
    parser.add_argument("--speed", type=float, help="of the simulated time; needs use_sim_time")
    parser.add_argument("--limit-s", type=float, default=SimulatorOptions.limit_s)
    given, rest = parser.parse_known_args(arguments)
    if given.map is not None and (given.start is None or given.goal is None):
        parser.error("--map: expected --start and --goal as well")
    try:
        if given.map is not None:
            world = world_of_map(given.map, Pose(*given.start), tuple(given.goal))
        else:
            worlds = load_worlds(given.worlds)
            world = worlds[given.world % len(worlds)]
    except AnchorFlowError as error:
        parser.error(str(error))
    options = SimulatorOptions(
        world=world,
        radius=given.radius,
        limit_s=given.limit_s,
        speed=given.speed,
        whole_map=given.whole_map,
        inflation=Inflation(radius=given.inflation, inscribed=given.radius),
    )
    return options, rest


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate until the run ends; exit with 0 if the robot has arrived."""
    options, rest = parse(arguments)
    rclpy.init(args=rest)
    simulator, executor = Simulator(options), SingleThreadedExecutor()
    executor.add_node(simulator)
    try:
        with suppress(KeyboardInterrupt, ExternalShutdownException):
            while rclpy.ok() and simulator.result is None:
                executor.spin_once()
    finally:
        simulator.destroy_node()
        rclpy.try_shutdown()
    print(json.dumps(simulator.result), flush=True)  # noqa: T201
    raise SystemExit(simulator.result is None or simulator.result["end"] != "goal")


if __name__ == "__main__":
    main()
