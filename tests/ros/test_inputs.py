"""Goal, footprint, speed limit and tracks from their messages."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from anchorflow_client import InvalidRequest
from anchorflow_ros.frames import Pose, StaticFrames
from anchorflow_ros.inputs import (
    Goal,
    footprint_of,
    seconds_and_nanoseconds,
    speed_limit_of,
    tracks_of,
)

BOX = [(0.4, 0.3), (-0.4, 0.3), (-0.4, -0.3), (0.4, -0.3)]


def test_a_goal_is_brought_into_the_map(make: Any) -> None:
    goal = Goal.of(make.goal(1, 0, frame_id="odom"))

    seen = goal.seen_from("map", StaticFrames(["map odom 0 2 1.5707963267948966"]), at=10.0)

    assert_allclose([seen.x, seen.y, seen.yaw], [0, 3, math.pi / 2], atol=1e-9)


def test_the_same_goal_again_is_the_same(make: Any) -> None:
    goal = Goal.of(make.goal(1, 2))

    assert goal.is_at(Goal.of(make.goal(1, 2, stamp=12.0)))
    assert not goal.is_at(Goal.of(make.goal(1, 2.1)))
    assert not goal.is_at(None)


def test_a_footprint_where_the_robot_stands_is_brought_back(make: Any) -> None:
    robot = Pose(5.0, -1.0, 0.9)

    about = footprint_of(make.polygon(BOX))
    published = footprint_of(make.polygon(robot.place(BOX), frame_id="odom"), robot=robot)

    assert_allclose(about, BOX, atol=1e-6)
    assert_allclose(published, BOX, atol=1e-5)


def test_a_footprint_without_an_area_is_refused(make: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"footprint: expected three or more.*got 2 corners"):
        footprint_of(make.polygon(BOX[:2]))


@pytest.mark.parametrize(
    ("message", "limit"),
    [
        (SimpleNamespace(data=0.5), 0.5),
        (SimpleNamespace(data=0.0), None),
        (SimpleNamespace(percentage=True, speed_limit=25.0), 0.5),
        (SimpleNamespace(percentage=False, speed_limit=1.5), 1.5),
    ],
)
def test_speed_limits(message: Any, limit: float | None) -> None:
    """The fields of std_msgs/Float32, and of nav2_msgs/SpeedLimit, which has no wheel."""
    assert speed_limit_of(message, v_max=2.0) == limit
    with pytest.raises(InvalidRequest, match="speed_limit"):
        speed_limit_of(SimpleNamespace(data=-0.5), v_max=2.0)


def test_tracks_are_points_with_a_velocity_and_a_radius(make: Any) -> None:
    names = ("radius", "x", "score", "y", "vx", "vy")  # in any order, with further fields
    tracks = tracks_of(
        make.tracks([[0.3, 1, 9, 2, 0.5, 0], [0.25, 3, 9, 4, 0, -1]], names), growth=0.1
    )

    obstacles = tracks.obstacles
    assert_allclose(obstacles.position, [[1, 2], [3, 4]])
    assert_allclose(obstacles.later(1.0).position, [[1.5, 2], [3, 3]])
    assert_allclose(obstacles.radius, [0.3, 0.25])
    assert (obstacles.growth, tracks.stamp) == (0.1, 10.0)
    assert len(tracks_of(make.tracks(np.empty((0, 5)))).obstacles.position) == 0


ROW = [1, 2, 0.5, 0, 0.3]


@pytest.mark.parametrize(
    ("rows", "names", "width", "words"),
    [
        ([[1, 2, 0.3]], ("x", "y", "radius"), 1, "got x, y, radius; vx is missing"),
        ([ROW], None, 2, "expected 1 rows of 40 bytes, got 20 bytes"),
        ([[math.nan, *ROW[1:]]], None, 1, r"obstacles\.position"),
    ],
    ids=["no velocity", "too short", "not a number"],
)
def test_what_is_no_track_is_refused(
    make: Any, rows: list[list[float]], names: tuple[str, ...] | None, width: int, words: str
) -> None:
    message = make.tracks(rows, names) if names else make.tracks(rows)
    message.width = width

    with pytest.raises(InvalidRequest, match=words):
        tracks_of(message)


def test_tracks_are_brought_into_the_map(make: Any) -> None:
    tracks = tracks_of(make.tracks([[1, 0, 1, 0, 0.3]], frame_id="odom"))

    seen = tracks.seen_from("map", StaticFrames(["map odom 0 2 1.5707963267948966"]))

    assert_allclose(seen.position, [[0, 3]], atol=1e-6)
    assert_allclose(seen.later(1.0).position, [[0, 4]], atol=1e-6)


def test_a_time_is_split_without_a_whole_second_of_nanoseconds() -> None:
    assert seconds_and_nanoseconds(1.5) == (1, 500_000_000)
    assert seconds_and_nanoseconds(1.9999999999) == (2, 0)
