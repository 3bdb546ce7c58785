"""Odometry: frames of pose and twist, the acceleration, and where the robot will be."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from anchorflow_client import InvalidRequest
from anchorflow_ros.frames import StaticFrames
from anchorflow_ros.odometry import OdometryReader, RobotMotion


def test_the_twist_is_in_the_childs_frame(make: Any) -> None:
    motion = OdometryReader().read(make.odometry(1, 2, math.pi / 2, twist=(0.5, 0.1, 0.0)))

    assert_allclose(motion.velocity, [-0.1, 0.5], atol=1e-12)
    assert_allclose(motion.x_curr(a_max=3.0), [1, 2, -0.1, 0.5, 0, 0], atol=1e-12)


def test_a_bend_pulls_inwards(make: Any) -> None:
    motion = OdometryReader().read(make.odometry(0, 0, 0.0, twist=(1.0, 0.0, 0.8)))

    assert_allclose(motion.x_curr(a_max=3.0)[4:], [0.0, 0.8])
    assert_allclose(motion.x_curr(a_max=0.5)[4:], [0.0, 0.5])
    assert_allclose(
        motion.x_curr(a_max=3.0, with_heading=True), [0, 0, 0, 1, 0, 0.8, 0, 0.8, 0], atol=1e-12
    )


def steady_push(make: Any, reader: OdometryReader, push: float, count: int = 40) -> RobotMotion:
    motions = [
        reader.read(make.odometry(0, 0, twist=(push * 0.02 * k, 0.0, 0.0), stamp=10 + 0.02 * k))
        for k in range(count)
    ]
    return motions[-1]


def test_the_acceleration_of_a_steady_push_is_found(make: Any) -> None:
    assert steady_push(make, OdometryReader(), 1.5).acceleration[0] == pytest.approx(1.5, abs=0.02)


def test_a_jump_of_the_clock_is_no_acceleration(make: Any) -> None:
    for stamp in (5.0, 20.0):
        reader = OdometryReader()
        steady_push(make, reader, 1.5)

        later = reader.read(make.odometry(0, 0, twist=(0.0, 0.0, 0.0), stamp=stamp))

        assert_allclose(later.acceleration, 0.0)


def test_a_robot_that_turns_as_it_drives_is_on_a_circle(make: Any) -> None:
    motion = OdometryReader().read(make.odometry(1, 0, math.pi / 2, twist=(1.0, 0.0, 1.0)))

    for seconds in (0.3, math.pi):  # about the origin
        later = motion.after(seconds).pose
        assert_allclose([later.x, later.y], [math.cos(seconds), math.sin(seconds)], atol=1e-9)
        assert math.cos(later.yaw - seconds - math.pi / 2) == pytest.approx(1.0)


def test_a_commanded_twist_replaces_the_measured_one(make: Any) -> None:
    motion = OdometryReader().read(make.odometry(0, 0, twist=(1.0, 0.0, 0.0)))

    later = motion.after(0.5, np.array([0.4, 0.0, 0.0]))

    assert (later.pose.x, later.stamp) == (pytest.approx(0.2), pytest.approx(10.5))


@pytest.mark.parametrize("field", ["pose", "twist"])
def test_numbers_that_are_not_finite_are_refused_by_name(make: Any, field: str) -> None:
    message = make.odometry(0, 0)
    if field == "pose":
        message.pose.pose.position.x = math.nan
    else:
        message.twist.twist.angular.z = math.inf

    with pytest.raises(InvalidRequest, match=rf"odometry\.{field}"):
        OdometryReader().read(message)


def test_a_pose_is_brought_into_the_map(make: Any) -> None:
    frames = StaticFrames(["map odom 10 0 1.5707963267948966"])
    motion = OdometryReader().read(make.odometry(1, 0, twist=(1.0, 0.0, 0.0), frame_id="odom"))

    seen = motion.seen_from("map", frames)

    assert (seen.pose.x, seen.pose.y) == (pytest.approx(10), pytest.approx(1))
    assert_allclose(seen.velocity, [0, 1], atol=1e-9)


def test_the_base_may_lie_elsewhere_on_the_robot(make: Any) -> None:
    """A base 0.5 m behind what the odometry tracks swings out when the robot turns on the spot."""
    reader = OdometryReader(base_frame="rear", frames=StaticFrames(["base_link rear -0.5 0 0"]))

    motion = reader.read(make.odometry(1, 0, 0.0, twist=(0.0, 0.0, 2.0)))

    assert motion.pose.x == pytest.approx(0.5)
    assert_allclose(motion.twist, [0.0, -1.0, 2.0], atol=1e-12)
