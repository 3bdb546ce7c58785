"""The node's decisions: it drives to a goal, and brakes with a reason when something fails."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'anchorflow[ros]'")

from rehearsed_robot import TICK_S, Rehearsal, Switched

from anchorflow_ros.driver import Decision, braked
from anchorflow_ros.faults import ERROR, OK
from anchorflow_ros.frames import ORIGIN, Pose
from anchorflow_ros.parameters import Settings
from anchorflow_ros.simulation import Base
from anchorflow_service.local import LocalClient


@pytest.fixture(scope="module")
def planner() -> LocalClient:
    return LocalClient.of()


@pytest.fixture
def client(planner: LocalClient) -> Switched:
    return Switched(planner.plan_request)


def driving(client: Switched, **options: Any) -> Rehearsal:
    """A robot under way to a goal 4 m ahead."""
    robot = Rehearsal(client, **options)
    robot.go(4.0, 0.0)
    robot.run(1.5)
    assert robot.base.v > 0.5
    return robot


def reason(decision: Decision) -> str:
    assert decision.braking
    return f"{decision.faults[0].part}: {decision.faults[0].text}"


def test_a_robot_drives_to_its_goal_and_stands(client: Switched) -> None:
    robot = Rehearsal(client)
    robot.cells[28:36, 34:36] = 100  # 1.4 to 1.6 m ahead
    robot.go(4.0, 0.0)

    decisions = robot.run_until(lambda decision: decision.idle)

    assert reason(decisions[-1]) == "goal: arrived"
    robot.run(1.0)
    assert math.hypot(robot.base.pose.x - 4.0, robot.base.pose.y) < 0.4
    assert (robot.base.v, robot.base.w) == (0.0, 0.0)
    robot.go(4.0, 0.0)  # by a publisher that repeats it
    assert robot.tick().idle
    # Carried back to the start, it waits for a goal, be it the same.
    robot.base = Base(ORIGIN)
    assert robot.tick().idle
    robot.go(4.0, 0.0)
    robot.run_until(lambda decision: decision.idle)
    assert math.hypot(robot.base.pose.x - 4.0, robot.base.pose.y) < 0.4


def test_a_robot_drives_where_all_ground_is_inflated(client: Switched) -> None:
    robot = Rehearsal(client)
    robot.cells[:] = 80

    robot.go(4.0, 0.0)
    decisions = robot.run_until(lambda decision: decision.idle)

    assert reason(decisions[-1]) == "goal: arrived"


def test_plans_begin_where_the_robot_will_be(client: Switched) -> None:
    robot = driving(client, service__lead_s=0.2)
    at, v = robot.base.pose.x, robot.base.v
    before = len(client.requests)
    robot.run_until(lambda _: len(client.requests) > before, limit_s=0.3)

    start = client.requests[-1].x_curr[0]

    assert at + 0.19 * v <= start[0] <= at + 0.4 * v + 0.05
    assert start[2] == pytest.approx(v, abs=0.15)


def test_without_a_goal_it_stands_and_sends_no_request(client: Switched) -> None:
    decisions = Rehearsal(client).run(0.5)

    assert all(decision.idle and not decision.twist.any() for decision in decisions)
    assert decisions[-1].faults[0].level == OK
    assert client.requests == []


def no_odometry(robot: Rehearsal, x: float = math.nan, *, ahead_s: float = 0.0) -> None:
    """Send one odd message of odometry, and no further ones."""
    robot.odometry = False
    robot.inputs.on_odometry(robot.make.odometry(x, 0.0, stamp=robot.clock.now + ahead_s))


class Case(NamedTuple):
    """What goes wrong, why the robot brakes and how soon, and what mends it, if anything has to."""

    begin: Callable[[Rehearsal], object]
    words: str
    mend: Callable[[Rehearsal], object] | None = None
    within_s: float = TICK_S
    later: str = ""
    """A part of the reason after a second."""


def publish_again(robot: Rehearsal) -> None:
    robot.odometry = robot.maps = True
    robot.client.off = False


CASES = {
    "a service that is killed": Case(
        lambda robot: setattr(robot.client, "off", True),
        "service: no answer for 0.",
        publish_again,
        within_s=0.35,
        later="nobody listens",
    ),
    "a map that stops": Case(
        lambda robot: setattr(robot, "maps", False),
        "map: no message for 0.3",
        publish_again,
        within_s=0.45,
    ),
    "odometry that stops": Case(
        lambda robot: setattr(robot, "odometry", False),
        "odometry: the last message is 0.3",
        publish_again,
        within_s=0.45,
    ),
    "odometry that is not a number": Case(
        no_odometry, "odometry: odometry.pose.position: expected numbers", publish_again
    ),
    "clocks that differ": Case(
        lambda robot: no_odometry(robot, 0.0, ahead_s=3.0),
        "odometry: its stamp is 3.00 s ahead of the node's clock",
        publish_again,
    ),
    "a goal off the map": Case(
        lambda robot: robot.go(40.0, 0.0),
        "goal: (40.00, 0.00) m is off the map",
        lambda robot: robot.go(3.0, 0.0),
    ),
    "a goal that is not a number": Case(
        lambda robot: robot.go(math.nan, 0.0), "goal: goal.pose", lambda robot: robot.go(3.0, 0.0)
    ),
    "a goal in an unknown frame": Case(
        lambda robot: robot.go(1.0, 0.0, frame_id="odom"),
        "frames: ",
        lambda robot: robot.go(3.0, 0.0),
    ),
    "a clock that goes back": Case(
        lambda robot: robot.clock.advance(-20.0),
        "clock: it jumped by -19.95 s; everything begins anew",
    ),
    "a clock that leaps": Case(
        lambda robot: robot.clock.advance(20.0), "clock: it jumped by +20.05 s"
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_goes_wrong_means_braking_until_it_is_mended(client: Switched, name: str) -> None:
    case, robot = CASES[name], driving(client, map__timeout_s=0.3)
    case.begin(robot)

    decision = robot.run_until(lambda decision: decision.braking, limit_s=case.within_s)[-1]

    assert reason(decision).startswith(case.words)
    assert decision.faults[0].level == ERROR
    if case.mend is not None:
        assert case.later in reason(robot.run(1.0)[-1])
        assert robot.base.v == 0.0
        case.mend(robot)
    assert reason(robot.run_until(lambda decision: decision.idle)[-1]) == "goal: arrived"


def test_a_goal_off_a_rolling_window_is_approached(client: Switched) -> None:
    robot = Rehearsal(client, goal__beyond_map="approach")
    robot.go(40.0, 0.0)

    robot.run(3.0)

    assert robot.base.v > 0.5


def test_a_clock_that_stands_means_braking(client: Switched) -> None:
    robot = driving(client)
    now = robot.clock.now

    decisions = [robot.driver.tick(now, steady=robot.steady + 0.05 * k) for k in range(9)]

    assert not decisions[3].braking
    assert reason(decisions[-1]).startswith("clock: it has been at")


def test_the_same_goal_again_does_not_begin_anew(client: Switched) -> None:
    robot = driving(client)
    robot.go(4.0, 0.0, stamp=60.0)

    assert not any(decision.braking for decision in robot.run(0.3))


def test_a_cancelled_goal_stops_the_robot(client: Switched) -> None:
    robot = driving(client)
    robot.inputs.cancel()

    assert reason(robot.run(1.5)[-1]) == "goal: none"
    assert robot.base.v == 0.0


def test_a_speed_limit_is_kept(client: Switched) -> None:
    robot = driving(client)
    robot.inputs.on_speed_limit(type("Limit", (), {"data": 0.3})())

    robot.run(0.5)  # it brakes
    before = robot.base.pose.x
    later = robot.run(3.0)

    assert all(np.hypot(*decision.twist[:2]) <= 0.31 for decision in later)
    assert robot.base.pose.x > before + 0.3
    assert client.requests[-1].v_max is not None
    assert client.requests[-1].v_max <= 0.35


def test_tracks_are_sent_as_they_will_be(client: Switched) -> None:
    robot = driving(client)
    now = robot.clock.now
    robot.inputs.on_tracks(robot.make.tracks([[3.0, 2.0, 0.0, -1.0, 0.3]], stamp=now - 0.3))
    before = len(client.requests)
    robot.run_until(lambda _: len(client.requests) > before, limit_s=0.3)

    obstacles = client.requests[-1].obstacles

    assert obstacles is not None
    ahead = robot.settings["service.lead_s"] + 0.3
    assert obstacles.position[0, 1] == pytest.approx(2.0 - ahead, abs=0.16)


def test_tracks_that_are_old_are_dropped_with_a_warning(client: Switched) -> None:
    robot = driving(client)
    robot.inputs.on_tracks(robot.make.tracks([[9.0, 2.0, 0.0, 0.0, 0.3]], stamp=robot.clock.now))

    decision = robot.run(1.3)[-1]

    assert not decision.braking
    assert any(fault.part == "tracks" for fault in decision.faults)
    assert client.requests[-1].obstacles is None


def test_a_footprint_replaces_the_body_of_the_parameters(client: Switched) -> None:
    robot = driving(client)
    box = [(0.4, 0.3), (-0.3, 0.3), (-0.3, -0.3), (0.4, -0.3)]
    robot.inputs.on_footprint(robot.make.polygon(box))
    robot.run(0.5)

    assert client.requests[-1].robot_radius == pytest.approx(0.5)
    robot.inputs.on_footprint(robot.make.polygon(box[:2]))
    assert robot.inputs.robot.reach == pytest.approx(0.5)
    assert any(fault.part == "footprint" for fault in robot.tick().faults)


def test_anchors_with_headings_are_requested_by_a_parameter(client: Switched) -> None:
    robot = Rehearsal(client, start=Pose(0.0, 0.0, 0.5), robot__plan_poses=True)
    robot.go(3.0, 0.0)
    robot.run(0.3)

    request = client.requests[0]

    assert request.kinematics is not None
    assert request.kinematics.kind == "differential"
    assert request.x_curr[0, 2] == pytest.approx(0.5)
    assert request.x_goal.shape == (1, 6)


def test_braking_keeps_the_arc_and_ends() -> None:
    robot = Settings.of().robot
    twist = np.array([0.6, 0.0, 0.3])

    slower = braked(twist, robot, 0.1)

    np.testing.assert_allclose(slower, twist * (0.6 - 0.15) / 0.6)
    for _ in range(5):
        slower = braked(slower, robot, 0.1)
    assert not slower.any()
    np.testing.assert_allclose(braked(np.array([0.0, 0.0, -1.0]), robot, 0.1), [0.0, 0.0, -0.6])
