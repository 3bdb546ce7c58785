"""What is called safe is safe, and bisection makes safe what it can."""

import numpy as np
import pytest

from anchorflow_trajectory.bisection import bisect_to_safe
from anchorflow_trajectory.clearance import GridField, clearance_field
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.spline import spline_basis
from anchorflow_trajectory.verify import verify

LIMITS = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=8.0)
BASIS = spline_basis(64, 8.0)
X_CURR = np.asarray([1.0, 3.2, 0, 0, 0, 0], np.float32)
X_GOAL = np.asarray([5.4, 3.2, 0, 0], np.float32)


def post() -> GridField:
    occupied = np.zeros((64, 64), bool)
    occupied[28:36, 28:36] = True
    return GridField(clearance_field(occupied, 0.1, 0.25), 0.1, np.zeros(2))


def bows(heights: list[float]) -> np.ndarray:
    """Curves from start to goal that pass the post at these heights [m] beside the axis."""
    rest = BASIS.rest_curve(X_CURR, X_GOAL)
    control = np.repeat(rest[:, None], len(heights), axis=1)
    bulge = np.sin(np.linspace(0.0, np.pi, BASIS.num_control_points)) ** 2
    control[1] += np.asarray(heights, np.float32)[:, None] * bulge.astype(np.float32)
    return control


def test_a_collision_and_each_limit_are_told() -> None:
    states = BASIS.states(bows([0.0, 1.2, -1.2]))
    assert verify(states, post(), LIMITS).safe.tolist() == [False, True, True]
    slow = MotionLimits(v_max=0.8, a_max=3.0, horizon_s=8.0)
    assert not verify(states, post(), slow).safe.any()
    weak = MotionLimits(v_max=2.0, a_max=0.2, horizon_s=8.0)
    assert not verify(states, post(), weak).safe.any()


def test_the_verdict_holds_against_a_finer_look() -> None:
    rng = np.random.default_rng(2)
    position, velocity, acceleration = BASIS.states(bows(list(rng.uniform(-1.5, 1.5, 200))))
    verdict = verify((position, velocity, acceleration), post(), LIMITS)
    cells = (np.argwhere(post().values <= -0.25) + 0.5)[:, ::-1] * 0.1
    for path, clear in zip(position, verdict.clearance, strict=True):
        along = np.linspace(0, 63, 2000)
        fine = np.stack([np.interp(along, np.arange(64), path[:, k]) for k in (0, 1)], -1)
        gap = np.maximum(np.abs(fine[:, None] - cells) - 0.05, 0.0)
        exact = np.hypot(gap[..., 0], gap[..., 1]).min() - 0.25
        if clear > 0:
            assert exact > clear - 0.02
    assert 0.2 < verdict.safe.mean() < 0.9


def safe_of(control: np.ndarray) -> np.ndarray:
    return verify(BASIS.states(control), post(), LIMITS).safe


def test_bisection_moves_failures_to_the_safe_side_that_is_near() -> None:
    control = bows([1.4, -1.4, 0.5, -0.3])
    moved = bisect_to_safe(control, safe_of(control), BASIS, post(), LIMITS)
    assert safe_of(moved).all()
    np.testing.assert_array_equal(moved[:, :2], control[:, :2])
    heights = moved[1, :, 9] - 3.2
    assert 0.5 < heights[2] < 1.4
    assert -1.4 < heights[3] < -0.3


@pytest.mark.parametrize("heights", [[0.0, 0.1], [1.3, -1.3]])
def test_bisection_leaves_all_as_it_is_where_none_or_all_are_safe(heights: list[float]) -> None:
    control = bows(heights)
    np.testing.assert_array_equal(
        bisect_to_safe(control, safe_of(control), BASIS, post(), LIMITS), control
    )
