"""Where nothing that was drawn is safe, a route is begun on anew: round corners, and braking."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_client.contract import RefineSpec
from anchorflow_trajectory.finish.refined import Refined
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene

RADIUS, RESOLUTION, WALL = 0.25, 0.1, 0.5  # m
ANCHORS = 8
SPEC = RefineSpec(smooth=True, project=True, safety_margin=0.1, guidance=0.0)


def corridor(turns: int, *, width: float, size: float) -> tuple[np.ndarray, ...]:
    """Along the lower edge, up the right one, and with a second turn back along the upper one."""
    cells, w, wall = round(size / RESOLUTION), round(width / RESOLUTION), round(WALL / RESOLUTION)
    occupied = np.ones((cells, cells), np.float32)
    occupied[wall : wall + w, wall:-wall] = 0.0
    occupied[wall:-wall, -wall - w : -wall] = 0.0
    low, high = WALL + width / 2, size - WALL - width / 2
    if turns == 2:
        occupied[-wall - w : -wall, wall:-wall] = 0.0
    return occupied, np.array([low, low]), np.array([high if turns == 1 else low, high])


def refined(
    occupied: np.ndarray, x_curr: np.ndarray, x_goal: np.ndarray, motion: MotionLimits
) -> Refined:
    """Several copies of the route's own spline, finished."""
    scene = Scene(
        cost_map=occupied[None],
        resolution=RESOLUTION,
        origin=np.zeros(2),
        robot_radius=RADIUS,
        x_curr=np.pad(x_curr, (0, 6 - len(x_curr))),
        x_goal=np.pad(x_goal, (0, 4 - len(x_goal))),
        w_style=np.array([0.4, 0.3, 0.3]),
        motion=motion,
    )
    states = np.repeat(scene.route_states[:1], ANCHORS, axis=0)
    return Refiner(scene, 20).refine(states, np.zeros(ANCHORS, np.intp), SPEC)


def serpentine(lanes: int, *, width: float) -> tuple[np.ndarray, ...]:
    """Lanes of 8 m above one another, joined at their ends by turns."""
    wall, w, cells = round(0.2 / RESOLUTION), round(width / RESOLUTION), round(9.0 / RESOLUTION)
    pitch = w + wall
    occupied = np.zeros((lanes * pitch + wall, cells), np.float32)
    occupied[:, :wall] = occupied[:, -wall:] = 1.0
    for lane in range(lanes + 1):
        occupied[lane * pitch : lane * pitch + wall] = 1.0
        if 0 < lane < lanes:
            gap = slice(-wall - w, -wall) if lane % 2 else slice(wall, wall + w)
            occupied[lane * pitch : lane * pitch + wall, gap] = 0.0
    low, left = (wall + w / 2) * RESOLUTION, (wall + w / 2) * RESOLUTION
    high = low + (lanes - 1) * pitch * RESOLUTION
    return occupied, np.array([left, low]), np.array([9.0 - left if lanes % 2 else left, high])


@pytest.mark.parametrize(
    "way",
    [
        corridor(1, width=1.0, size=25.6),
        corridor(2, width=1.5, size=25.6),
        corridor(1, width=1.5, size=51.2),
        corridor(2, width=3.0, size=51.2),
        serpentine(6, width=1.0),  # more corners than eighteen control points hold
    ],
    ids=["a turn", "two turns", "a large turn", "two large turns", "six lanes"],
)
def test_a_corridor_is_turned_in(way: tuple[np.ndarray, ...]) -> None:
    occupied, start, goal = way

    anchors = refined(occupied, start, goal, MotionLimits(2.0, 3.0))

    assert anchors.safe.all()
    assert anchors.positions.shape[1] == 64
    np.testing.assert_allclose(anchors.positions[:, 0], np.tile(start, (ANCHORS, 1)), atol=1e-4)
    np.testing.assert_allclose(anchors.positions[:, -1], np.tile(goal, (ANCHORS, 1)), atol=1e-4)


@pytest.mark.parametrize(
    ("x_curr", "x_goal", "motion"),
    [
        ([20.0, 25.0, 5.4, 0.0], [30.0, 25.0], MotionLimits(6.0, 3.0)),
        ([20.0, 25.0, -1.8, 0.0], [22.0, 25.0], MotionLimits(2.0, 0.5)),
        ([20.0, 25.0], [30.0, 25.0, -4.5, 0.0], MotionLimits(5.0, 4.0)),
        # Who must turn round within a horizon takes long steps.
        ([20.0, 25.0, -5.0, 0.0], [40.0, 25.0], MotionLimits(5.0, 4.0, horizon_s=8.0)),
        ([20.0, 25.0, -5.0, 0.0], [40.0, 25.0], MotionLimits(5.0, 4.0, horizon_s=25.0)),
    ],
)
def test_who_is_fast_and_heavy_brakes(
    x_curr: list[float], x_goal: list[float], motion: MotionLimits
) -> None:
    free = np.zeros((500, 500), np.float32)

    anchors = refined(free, np.array(x_curr), np.array(x_goal), motion)

    assert anchors.safe.all()
    velocity = np.pad(np.array(x_curr[2:]), (0, 4 - len(x_curr)))
    np.testing.assert_allclose(anchors.velocities[:, 0], np.tile(velocity, (ANCHORS, 1)), atol=1e-3)


@pytest.mark.parametrize(
    ("acceleration", "v_max", "a_max"),
    [
        ((0.8, 0.0), 0.26, 1.0),
        ((2.0, 0.0), 0.26, 2.5),
        ((0.0, 2.0), 0.26, 2.5),
        ((6.4, 0.0), 0.2, 8.0),
    ],
)
def test_who_is_slow_for_its_brakes_may_be_gaining_speed(
    acceleration: tuple[float, float], v_max: float, a_max: float
) -> None:
    free = np.zeros((200, 200), np.float32)
    x_curr = np.array([6.0, 10.0, 0.0, 0.0, *acceleration])

    anchors = refined(free, x_curr, np.array([9.0, 10.0]), MotionLimits(v_max, a_max))

    assert anchors.safe.all()


def test_a_horizon_is_kept() -> None:
    occupied, start, goal = corridor(1, width=1.0, size=25.6)

    anchors = refined(occupied, start, goal, MotionLimits(2.0, 3.0, horizon_s=60.0))

    assert anchors.safe.all()
    np.testing.assert_allclose(anchors.duration, 60.0)


def test_where_no_way_leads_nothing_is_found() -> None:
    occupied, start, goal = corridor(1, width=1.0, size=25.6)
    occupied[100, :] = 1.0

    anchors = refined(occupied, start, goal, MotionLimits(2.0, 3.0))

    assert not anchors.safe.any()
