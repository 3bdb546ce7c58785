"""A path that is called safe is safe."""

import numpy as np
import pytest

from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.finish.certificate import are_safe, path_clearance, verify
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.spline.basis import Ends, Splines, spline_basis

RADIUS = 0.25  # m
LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
BASIS = spline_basis(64)
ENDS = Ends(np.array([1.0, 3.2, 0, 0, 0, 0]), np.array([5.4, 3.2, 0, 0]))


def post() -> GridField:
    occupied = np.zeros((64, 64), bool)
    occupied[28:36, 28:36] = True
    return GridField(clearance_field(occupied, 0.1, RADIUS), 0.1, np.zeros(2))


def bows(heights: list[float], duration: float = 8.0) -> Splines:
    """Curves from start to goal that pass the post at these heights [m] beside the axis."""
    splines = BASIS.rest_curves(ENDS, np.full(len(heights), duration))
    bulge = np.sin(np.linspace(0.0, np.pi, BASIS.num_control_points)) ** 2
    splines.control[1] += np.outer(heights, bulge).astype(np.float32)
    return splines


def test_a_collision_and_each_limit_are_told() -> None:
    states = BASIS.states(bows([0.0, 1.2, -1.2]))
    assert verify(states, post(), LIMITS).safe.tolist() == [False, True, True]
    slow = MotionLimits(v_max=0.8, a_max=3.0)
    assert not verify(states, post(), slow).safe.any()
    weak = MotionLimits(v_max=2.0, a_max=0.2)
    assert not verify(states, post(), weak).safe.any()
    # The same ways in a quarter of the time: nothing nearer, and too fast.
    hasty = verify(BASIS.states(bows([0.0, 1.2, -1.2], 2.0)), post(), LIMITS)
    assert hasty.free.tolist() == [False, True, True]
    assert not hasty.feasible.any()


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


def test_ways_without_end_are_told_at_once_and_lie_far_out() -> None:
    """Followed at steps of 4 cm, the longest of these would take longer than the universe has."""
    ends = np.array([1e9, 3e38, np.inf, np.nan], np.float32)
    paths = np.zeros((len(ends), 3, 2), np.float32)
    paths[:, 1, 0] = ends

    clearance = path_clearance(post(), paths)

    assert (clearance < -1e6).all()
    assert abs(clearance[0] / 1e9 + 1) < 1e-3


def test_a_motion_is_followed_between_its_samples_along_its_curve() -> None:
    """Round a circle in legs of 45 degrees, one of which bulges towards the post."""
    angle = np.pi * (np.arange(9) / 4 - 1 / 8)
    path = np.array([1.6, 3.2]) + 0.85 * np.stack([np.cos(angle), np.sin(angle)], -1)[None]
    still = np.zeros_like(path)

    along_chords = path_clearance(post(), path)
    along_curve = verify((path, still, still), post(), LIMITS).clearance

    assert along_chords == pytest.approx(2.8 - 1.6 - 0.85 * np.cos(np.pi / 8) - RADIUS, abs=1e-3)
    assert along_curve == pytest.approx(2.8 - 1.6 - 0.85 - RADIUS, abs=0.01)


def test_splines_and_their_states_are_judged_alike_where_legs_are_long() -> None:
    few = spline_basis(10)
    splines = bows(list(np.linspace(-1.5, 1.5, 200)))

    safe = are_safe(splines, few, post(), LIMITS)

    np.testing.assert_array_equal(safe, verify(few.states(splines), post(), LIMITS).safe)
    assert 0.2 < safe.mean() < 0.9
