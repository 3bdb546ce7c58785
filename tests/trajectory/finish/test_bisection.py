"""Bisection makes safe what it can, on the way that it was on where that has anything safe."""

import numpy as np
import pytest

from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.finish.bisection import bisect_to_safe
from anchorflow_trajectory.finish.certificate import verify
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.spline.basis import Ends, Splines, spline_basis

LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
BASIS = spline_basis(64)
REST = Ends(np.array([1.0, 3.2, 0, 0, 0, 0]), np.array([5.4, 3.2, 0, 0]))
MOVING = Ends(np.array([1.0, 3.2, 0.6, 0, 0.1, 0]), np.array([5.4, 3.2, 0.5, 0]))


def post() -> GridField:
    occupied = np.zeros((64, 64), bool)
    occupied[28:36, 28:36] = True
    return GridField(clearance_field(occupied, 0.1, 0.25), 0.1, np.zeros(2))


def bows(heights: list[float], duration: list[float], ends: Ends = REST) -> Splines:
    """Curves from start to goal that pass the post at these heights [m] beside the axis."""
    splines = BASIS.rest_curves(ends, np.array(duration))
    bulge = np.sin(np.linspace(0.0, np.pi, BASIS.num_control_points)) ** 2
    free = BASIS.free
    splines.control[1, :, free] += np.outer(heights, bulge[free]).astype(np.float32)
    return splines


def safe_of(splines: Splines) -> np.ndarray:
    return verify(BASIS.states(splines), post(), LIMITS).safe


def bisected(splines: Splines, route: list[int], ends: Ends = REST) -> Splines:
    return bisect_to_safe(
        splines, safe_of(splines), ends, BASIS, post(), LIMITS, route=np.array(route)
    )


def heights(splines: Splines) -> np.ndarray:
    return splines.control[1, :, 9] - 3.2


@pytest.mark.parametrize("ends", [REST, MOVING], ids=["at rest", "moving"])
def test_failures_are_moved_to_the_safe_side_that_is_near(ends: Ends) -> None:
    splines = bows([1.2, -1.2, 0.3, -0.2], [11.0, 12.0, 9.0, 14.0], ends)
    moved = bisected(splines, [0, 1, 0, 1], ends)
    assert safe_of(moved).all()
    np.testing.assert_array_equal(moved.control[:, :2], splines.control[:, :2])
    np.testing.assert_array_equal(moved.duration[:2], splines.duration[:2])
    at = heights(moved)
    assert 0.3 < at[2] < 1.2
    assert -1.2 < at[3] < -0.2
    # Durations are mixed as the ways are, and both ends are met in what comes out.
    assert 9.0 < moved.duration[2] < 11.0
    assert 12.0 < moved.duration[3] < 14.0
    position, velocity, acceleration = BASIS.states(moved)
    start = np.concatenate([position[:, 0], velocity[:, 0], acceleration[:, 0]], -1)
    np.testing.assert_allclose(start, np.tile(ends.x_curr, (4, 1)), atol=1e-4)
    goal = np.concatenate([position[:, -1], velocity[:, -1]], -1)
    np.testing.assert_allclose(goal, np.tile(ends.x_goal, (4, 1)), atol=1e-5)


def test_the_same_route_comes_before_a_nearer_one() -> None:
    """Only a route that has nothing safe is given up."""
    splines = bows([0.9, -1.2, 0.3, 0.2], [11.0] * 4)
    own = bisected(splines, [0, 1, 1, 2])
    assert safe_of(own).all()
    at = heights(own)
    assert at[2] < -0.4  # to its own route, on the far side
    assert at[3] > 0.4  # its own has nothing safe: to the nearest


@pytest.mark.parametrize("apart", [[0.0, 0.1], [1.2, -1.2]])
def test_all_stays_as_it_is_where_none_or_all_are_safe(apart: list[float]) -> None:
    splines = bows(apart, [11.0, 11.0])
    assert bisected(splines, [0, 0]) is splines


def test_what_is_too_fast_takes_as_long_as_it_has_to() -> None:
    """The same way in 3 s: it comes back to as fast as is safe, and stays on its way."""
    splines = bows([1.2, 1.2], [11.0, 3.0])
    assert safe_of(splines).tolist() == [True, False]
    moved = bisected(splines, [0, 0])
    assert safe_of(moved).all()
    np.testing.assert_allclose(moved.control[:, 1], splines.control[:, 1], atol=1e-5)
    assert 3.0 < moved.duration[1] < 9.0
