"""The lifecycle node itself, in this process, with another node that listens."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'anchorflow[ros]'")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from anchorflow_ros.node import LATCHED, AnchorFlowNode

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class Stage:
    """The node, and a listener with what it has received."""

    def __init__(self, make: Any) -> None:
        self.make = make
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=10 + os.getpid() % 80)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.received: dict[str, list[Any]] = {}
        self.listener = rclpy.create_node("listener", context=self.context)
        self.executor.add_node(self.listener)
        for kind, topic in (
            (TwistStamped, "cmd_vel"),
            (DiagnosticArray, "/diagnostics"),
            (Path, "plan"),
            (MarkerArray, "candidates"),
        ):
            got = self.received.setdefault(topic, [])
            self.listener.create_subscription(kind, topic, got.append, 20)
        self.maps = self.listener.create_publisher(OccupancyGrid, "map", LATCHED)
        self.odometry = self.listener.create_publisher(Odometry, "odom", 5)
        self.goals = self.listener.create_publisher(PoseStamped, "goal_pose", 1)

    def node(self, **parameters: Any) -> AnchorFlowNode:
        given = {"service.silence_s": 5.0, "odometry.timeout_s": 5.0} | {
            name.replace("__", "."): value for name, value in parameters.items()
        }
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        made = AnchorFlowNode(context=self.context, parameter_overrides=overrides)
        self.executor.add_node(made)
        return made

    def spin_until(self, done: Callable[[], Any], limit_s: float = 60.0) -> bool:
        """Publish odometry and serve both nodes until something has happened."""
        end = time.monotonic() + limit_s
        while time.monotonic() < end and not done():
            self.odometry.publish(self.make.odometry(0.0, 0.0, stamp=time.time()))
            self.executor.spin_once(timeout_sec=0.02)
        return bool(done())

    def close(self) -> None:
        for each in self.executor.get_nodes():
            each.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def stage(make: Any) -> Iterator[Stage]:
    stage = Stage(make)
    yield stage
    stage.close()


def test_a_parameter_that_is_wrong_leaves_the_node_unconfigured(stage: Stage) -> None:
    assert stage.node(robot__kind="tricycle").trigger_configure() == FAILURE


def test_a_service_that_is_none_leaves_the_node_unconfigured(stage: Stage) -> None:
    assert stage.node(service__bundle="/nowhere").trigger_configure() == FAILURE


def test_an_active_node_plans_drives_and_stops(stage: Stage) -> None:
    node = stage.node()
    assert node.trigger_configure() == SUCCESS
    assert node.trigger_activate() == SUCCESS
    stage.maps.publish(stage.make.grid([[0] * 80] * 64, origin=(-2.0, -3.2), stamp=time.time()))
    stage.goals.publish(stage.make.goal(4.0, 0.0))
    commands, plans = stage.received["cmd_vel"], stage.received["plan"]

    assert stage.spin_until(lambda: plans and commands and commands[-1].twist.linear.x > 0.05)
    assert commands[-1].header.frame_id == "base_link"
    assert plans[-1].header.frame_id == "map"
    assert stage.spin_until(lambda: stage.received["candidates"])
    reports = stage.received["/diagnostics"]
    assert stage.spin_until(lambda: any(each.status[0].message == "driving" for each in reports))

    assert node.trigger_deactivate() == SUCCESS
    assert stage.spin_until(lambda: commands[-1].twist.linear.x == 0.0, limit_s=5.0)
    assert node.trigger_cleanup() == SUCCESS
    assert node.trigger_configure() == SUCCESS  # once more, from the beginning


def test_the_cancel_service_forgets_the_goal(stage: Stage) -> None:
    node = stage.node()
    node.trigger_configure()
    node.trigger_activate()
    stage.goals.publish(stage.make.goal(4.0, 0.0))
    reports = stage.received["/diagnostics"]
    seen: list[str] = []

    def last() -> str:
        seen.extend(status.message for each in reports for status in each.status)
        return seen[-1] if seen else ""

    assert stage.spin_until(lambda: "map: no message has arrived" in seen or not last())
    client = stage.listener.create_client(Trigger, "/anchorflow/cancel")
    assert stage.spin_until(client.service_is_ready)
    answer = client.call_async(Trigger.Request())

    assert stage.spin_until(answer.done)
    result: Any = answer.result()
    assert result.success
    assert stage.spin_until(lambda: reports and reports[-1].status[0].message == "goal: none")
