"""Poses and transforms in the plane."""

from __future__ import annotations

import math
from typing import Any

import pytest
from numpy.testing import assert_allclose

from anchorflow_client import InvalidRequest
from anchorflow_ros.frames import Pose, StaticFrames


def test_a_pose_and_its_inverse_cancel() -> None:
    pose = Pose(1.0, -2.0, 0.7)

    for both in (pose @ pose.inverse, pose.inverse @ pose):
        assert_allclose([both.x, both.y, both.yaw], 0.0, atol=1e-12)


def test_a_quarter_turn_moves_what_lies_ahead_to_the_left() -> None:
    pose = Pose(1.0, 2.0, math.pi / 2)

    assert_allclose(pose.place([[1.0, 0.0], [0.0, 1.0]]), [[1.0, 3.0], [0.0, 2.0]])
    assert_allclose(pose.turn([1.0, 0.0]), [0.0, 1.0], atol=1e-12)


def test_frames_are_found_through_others_and_backwards() -> None:
    frames = StaticFrames(["map odom 1 2 1.5707963267948966", "odom base_link 3 0 0"])

    forward, back = frames.between("map", "base_link"), frames.between("base_link", "map")

    assert_allclose([forward.x, forward.y, forward.yaw], [1.0, 5.0, math.pi / 2], atol=1e-9)
    assert_allclose(forward.inverse.place([0.5, 0.5]), back.place([0.5, 0.5]))
    assert frames.between("nowhere", "nowhere") == Pose(0.0, 0.0, 0.0)


def test_an_unknown_frame_is_named() -> None:
    with pytest.raises(InvalidRequest, match="from 'odom' to 'map', got none"):
        StaticFrames(["map lidar 0 0 0"]).between("map", "odom")


@pytest.mark.parametrize("text", ["map odom 1 2", "map odom 1 2 x", "map map 0 0 0", "a b 0 inf 0"])
def test_a_transform_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InvalidRequest, match=r"frames\.transforms"):
        StaticFrames([text])


def test_an_orientation_that_nobody_filled_is_refused(make: Any) -> None:
    message = make.goal(1.0, 2.0)
    message.pose.orientation.w = 0.0

    with pytest.raises(InvalidRequest, match=r"goal\.orientation: expected a unit quaternion"):
        Pose.of(message.pose, "goal")


def test_a_tilted_robot_has_the_yaw_of_its_heading(make: Any) -> None:
    """Roll by 0.2 about the heading: the yaw stays."""
    yaw, roll = 1.1, 0.2
    message = make.goal(0.0, 0.0, yaw)
    turn = message.pose.orientation
    half = math.sin(roll / 2), math.cos(roll / 2)
    turn.x, turn.y = turn.w * half[0], turn.z * half[0]
    turn.z, turn.w = turn.z * half[1], turn.w * half[1]

    assert Pose.of(message.pose, "goal").yaw == pytest.approx(yaw)
