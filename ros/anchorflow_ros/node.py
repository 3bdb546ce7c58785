"""The node: a robot's topics in, a velocity command and the plan out.

    python -m anchorflow_ros.node --ros-args -p goal.beyond_map:=approach -p map.timeout_s:=1.0

It is a lifecycle node; with the parameter `autostart` it configures and activates itself.
"""

from __future__ import annotations

import importlib
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseStamped, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float32
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from anchorflow_client.base_client import BaseClient
from anchorflow_client.errors import AnchorFlowError
from anchorflow_control.warm_up import compile_loops
from anchorflow_ros.driver import Decision, Driver
from anchorflow_ros.faults import OK, WARN, Fault
from anchorflow_ros.frames import StaticFrames
from anchorflow_ros.outputs import (
    candidates_of,
    header_of,
    path_of,
    trajectory_of,
    twist_of,
)
from anchorflow_ros.parameters import PARAMETERS, Settings
from anchorflow_ros.reports import Reports
from anchorflow_ros.services import client_of
from anchorflow_ros.tf import frames_of

LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
UPDATES = QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE)
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Reliable publishers are compatible with it."""
STEADY = ClockType.STEADY_TIME
WATCH_S = 0.05
LAST_TICKS = 10
"""Commands to stand after a robot has stopped; then other nodes may command it."""
UPDATE_TYPES = {
    "occupancy_grid": ("map_msgs.msg", "OccupancyGridUpdate"),
    "costmap": ("nav2_msgs.msg", "CostmapUpdate"),
}


class AnchorFlowNode(LifecycleNode):
    """Drives a robot to the goals of a topic, by the anchors of a service."""

    def __init__(self, name: str = "anchorflow", **options: Any) -> None:
        super().__init__(name, **options)
        for parameter, (default, text) in PARAMETERS.items():
            self.declare_parameter(parameter, default, ParameterDescriptor(description=text))
        self._driver: Driver | None = None
        self._client: BaseClient | None = None
        self._owned: list[Callable[[], Any]] = []
        self._outputs: dict[str, Any] = {}
        self._loops: list[Any] = []
        self._ticked_at = 0.0
        self._shown: str | None = None
        self._standing = 0
        self._reports: Reports | None = None

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, connect to the service, subscribe."""
        with self._logged():
            try:
                settings = Settings.of(
                    {name: self.get_parameter(name).value for name in PARAMETERS}
                )
                frames = frames_of(self, StaticFrames(settings.transforms))
                self._client = client_of(settings)
                self._driver = Driver(settings, self._client, frames=frames)
            except AnchorFlowError as error:
                self.get_logger().error(str(error))
                return TransitionCallbackReturn.FAILURE
            self._reports = Reports(self.get_fully_qualified_name().lstrip("/"))
            compile_loops()  # which would make the first tick seconds late
            self._publish_on(settings)
            self._subscribe(settings, self._driver)
            self.get_logger().info(f"plans by {settings['service']}")
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the loop in the clock of the stamps, and a watch in case that clock stands."""
        assert self._driver is not None
        with self._logged():
            self._loops = [
                self.create_timer(self._driver.settings.tick_s, self._tick),
                self.create_timer(WATCH_S, self._watch, clock=Clock(clock_type=STEADY)),
            ]
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop()
        self._release()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop()
        self._release()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the robot after a transition that raised."""
        self._stop()
        self._release()
        return super().on_error(state)

    @contextmanager
    def _logged(self) -> Iterator[None]:
        """Log what a transition raises, which rclpy does not."""
        try:
            yield
        except Exception:
            self.get_logger().error(traceback.format_exc())
            raise

    def stop_robot(self) -> None:
        if (publisher := self._outputs.get("command")) is not None:
            header = header_of(self._now(), self._base_frame())
            publisher.publish(twist_of(np.zeros(3), header))

    def _publish_on(self, settings: Settings) -> None:
        kinds: dict[str, tuple[Any, QoSProfile]] = {
            "command": (TwistStamped, NEWEST),
            "path": (Path, NEWEST),
            "candidates": (MarkerArray, NEWEST),
            "trajectory": (MultiDOFJointTrajectory, NEWEST),
            "diagnostics": (DiagnosticArray, UPDATES),
        }
        for name, (kind, qos) in kinds.items():
            publisher = self.create_lifecycle_publisher(kind, settings[f"topics.{name}"], qos)
            self._outputs[name] = publisher
            self._owned.append(lambda each=publisher: self.destroy_lifecycle_publisher(each))

    def _subscribe(self, settings: Settings, driver: Driver) -> None:
        inputs, map_type = driver.inputs, settings["map.type"]
        costmap, limit = (
            _optional("nav2_msgs.msg", "Costmap"),
            _optional("nav2_msgs.msg", "SpeedLimit"),
        )
        if map_type == "costmap" and costmap is None:
            self.get_logger().error("map.type: nav2_msgs is not installed; no map will arrive")
        topics: list[tuple[str, Any, QoSProfile, Callable[[Any], None]]] = [
            (
                "map",
                costmap if map_type == "costmap" else OccupancyGrid,
                LATCHED,
                lambda message: inputs.on_map(message, now=self._now()),
            ),
            (
                "map_updates",
                _optional(*UPDATE_TYPES[map_type]),
                UPDATES,
                lambda message: inputs.on_map_update(message, now=self._now()),
            ),
            ("odometry", Odometry, SENSOR, inputs.on_odometry),
            ("goal", PoseStamped, NEWEST, inputs.on_goal),
            ("footprint", PolygonStamped, NEWEST, inputs.on_footprint),
            ("tracks", PointCloud2, SENSOR, inputs.on_tracks),
            ("speed_limit", limit or Float32, NEWEST, inputs.on_speed_limit),
        ]
        for name, kind, qos, callback in topics:
            if kind is not None:
                made = self.create_subscription(kind, settings[f"topics.{name}"], callback, qos)
                self._owned.append(lambda each=made: self.destroy_subscription(each))
        service = self.create_service(Trigger, "~/cancel", self._on_cancel)
        self._owned.append(lambda: self.destroy_service(service))

    def _on_cancel(self, request: Any, response: Any) -> Any:
        del request
        if self._driver is not None:
            self._driver.inputs.cancel()
        response.success, response.message = True, "the robot brakes and stands"
        return response

    def _tick(self) -> None:
        assert self._driver is not None
        began, now = time.monotonic(), self._now()
        self._ticked_at = began
        decision = self._driver.tick(now, steady=began)
        self._command(decision, now)
        self._show(decision)
        assert self._reports is not None
        self._reports.note(began, time.monotonic())
        self._report(decision, now)

    def _watch(self) -> None:
        """Tick although no time passes, so that the robot brakes if the clock stands."""
        assert self._driver is not None
        if time.monotonic() - self._ticked_at > self._driver.settings["clock.stands_s"]:
            self._tick()

    def _command(self, decision: Decision, now: float) -> None:
        """Publish the twist; a robot that has stopped without a goal is left to others."""
        stands = decision.idle and not decision.twist.any()
        self._standing = self._standing + 1 if stands else 0
        if self._standing <= LAST_TICKS:
            header = header_of(now, self._base_frame())
            self._outputs["command"].publish(twist_of(decision.twist, header))

    def _show(self, decision: Decision) -> None:
        """Publish a plan that is new, to those who listen."""
        plan = decision.plan
        if plan is None or plan.batch is None or plan.request_id == self._shown:
            return
        self._shown = plan.request_id
        assert plan.best is not None  # the plan is usable
        batch, header = plan.batch, header_of(decision.starts_at, decision.frame_id)
        makers: dict[str, Callable[[], Any]] = {
            "path": lambda: path_of(batch, plan.best or 0, header),
            "trajectory": lambda: trajectory_of(batch, plan.best or 0, header),
            "candidates": lambda: candidates_of(batch, header),
        }
        for name, make in makers.items():
            if (publisher := self._outputs[name]).get_subscription_count():
                publisher.publish(make())

    def _report(self, decision: Decision, now: float) -> None:
        """Publish diagnostics, and log faults that are new."""
        assert self._driver is not None
        assert self._reports is not None
        if changed := self._reports.has_changed(decision):
            for fault in decision.faults:
                self._say(fault)
        counts = self._driver.planner.counts
        steady = time.monotonic()
        report = self._reports.due(decision, counts, now=now, steady=steady, changed=changed)
        if report is not None:
            self._outputs["diagnostics"].publish(report)

    def _say(self, fault: Fault) -> None:
        logger, text = self.get_logger(), f"{fault.part}: {fault.text}"
        if fault.level == OK:
            logger.info(text)
        elif fault.level == WARN:
            logger.warning(text)
        else:
            logger.error(text)

    def _stop(self) -> None:
        for loop in self._loops:
            self.destroy_timer(loop)
        if self._loops:
            self._loops = []
            self.stop_robot()

    def _release(self) -> None:
        for destroy in self._owned:
            destroy()
        self._owned, self._outputs = [], {}
        if self._driver is not None:
            self._driver.close()
        if self._client is not None:
            self._client.close()
        self._driver = self._client = None

    def _now(self) -> float:
        return 1e-9 * self.get_clock().now().nanoseconds

    def _base_frame(self) -> str:
        return self._driver.inputs.base_frame if self._driver is not None else ""


def _optional(package: str, name: str) -> Any:
    """Return a message class, or None if its package is not installed."""
    try:
        return getattr(importlib.import_module(package), name)
    except ImportError:
        return None


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node until it is interrupted."""
    rclpy.init(args=list(sys.argv if arguments is None else arguments))
    node = AnchorFlowNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        if node.get_parameter("autostart").value:
            done = node.trigger_configure()
            if done is not TransitionCallbackReturn.SUCCESS:
                raise SystemExit(1)
            node.trigger_activate()
        with suppress(KeyboardInterrupt, ExternalShutdownException):
            executor.spin()
    finally:
        if rclpy.ok():
            node.stop_robot()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
