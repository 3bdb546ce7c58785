"""Why nothing is safe: each cause is named by the figures that a reader can check."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_trajectory.finish.why_unsafe import why_unsafe
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene

FREE: tuple[tuple[slice | int, slice | int], ...] = ()
WALL = ((slice(None), 40),)
ROOM = ((slice(30, 51), 60), (slice(30, 51), 75), (30, slice(60, 76)), (50, slice(60, 76)))
EITHER_SIDE = ((slice(0, 38), 40), (slice(42, 80), 40))  # of a gap of 0.4 m


def scene(
    occupied: Any = FREE, *, velocity: float = 0.0, horizon_s: float | None = None, **fields: Any
) -> Scene:
    """8 m by 8 m in cells of 0.1 m, from (-3, 0) to (3, 0)."""
    cost_map = np.zeros((3, 80, 80), np.float32)
    for cells in occupied:
        cost_map[(0, *cells)] = 1.0
    return Scene(
        cost_map=cost_map,
        resolution=0.1,
        origin=np.full(2, -4.0),
        robot_radius=fields.get("radius", 0.25),
        x_curr=np.array([-3.0, 0.0, velocity, 0.0, fields.get("pull", 0.0), 0.0]),
        x_goal=np.array([3.0, 0.0, 0.0, 0.0]),
        w_style=np.array([0.4, 0.3, 0.3]),
        motion=MotionLimits(v_max=2.0, a_max=3.0, horizon_s=horizon_s),
    )


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            scene(((41, 8),)),
            "the start is 0.150 m from an obstacle, and robot_radius is 0.25 m; "
            "clear_start frees the cells under the robot",
        ),
        (
            scene(((41, 71),)),
            "the goal is 0.150 m from an obstacle, and robot_radius is 0.25 m; "
            "with goal_tolerance anchors may end beside it",
        ),
        (scene(velocity=5.0), "the start moves at 5.00 m/s, and v_max is 2 m/s"),
        (scene(pull=6.0), "the start accelerates by 6.00 m/s^2, and a_max is 3 m/s^2"),
        (scene(ROOM), "no way leads from the start to the goal: obstacles enclose the goal"),
        (scene(WALL), "obstacles part them; both ends reach the edge of the map, so a larger one"),
        (
            scene(EITHER_SIDE),
            "every gap is too narrow: the widest is about 0.30 m, 0.26 m less than the 0.56 m",
        ),
        (
            scene(horizon_s=2.0),
            "the shortest way is 6.0 m, and a robot of 2 m/s gets 2.0 m far in horizon_s = 2 s",
        ),
        (
            scene(((slice(20, 60), 20),), velocity=2.0),
            "the start is too fast: from 2.00 m/s it takes 1.03 m to stop smoothly, and there is "
            "room for 0.75 m",
        ),
        (scene(), "the widest way keeps -0.200 m of the 0.000 m that are asked for"),
    ],
)
def test_the_cause_is_named(asked: Scene, words: str) -> None:
    told = why_unsafe(asked, np.array([-0.2, -0.3]), certified_margin=0.0)
    assert told.startswith("none of 2 anchors is safe: ")
    assert words in told


def test_a_margin_counts() -> None:
    near = scene(((40, 6),))
    told = why_unsafe(near, np.array([0.04]), certified_margin=0.04)
    assert "the start keeps 0.052 m of the 0.040 m that are asked for and 0.030 m" in told
    told = why_unsafe(scene(), np.array([0.2]), certified_margin=0.1)
    assert "those that have room break a limit or keep the margin only just" in told
