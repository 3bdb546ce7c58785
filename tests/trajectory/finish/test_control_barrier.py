"""The control barrier: its bound holds, its correction is the closed form, what is clear stays."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.finish import control_barrier
from anchorflow_trajectory.finish.control_barrier import SHARPNESS, SLACK, ControlBarrier
from anchorflow_trajectory.spline.basis import Ends, Splines, spline_basis, whitening

BASIS = spline_basis(64)
ENDS = Ends(np.array([1.0, 3.2, 0, 0, 0, 0]), np.array([5.4, 3.2, 0, 0]))


@pytest.fixture
def barrier() -> ControlBarrier:
    """Round a post half way, in a map of 6.4 x 6.4 m."""
    occupied = np.zeros((64, 64), bool)
    occupied[28:36, 28:36] = True
    field = GridField(clearance_field(occupied, 0.1, 0.25), 0.1, np.zeros(2))
    return ControlBarrier(BASIS, field, 0.1)


def bows(heights: list[float]) -> Splines:
    """Curves that pass the post at these heights [m] beside the axis, in float64."""
    splines = BASIS.rest_curves(ENDS, np.linspace(5.0, 9.0, len(heights)))
    control = splines.control.astype(np.float64)
    control[1] += np.outer(heights, np.sin(np.linspace(0.0, np.pi, control.shape[2])) ** 2)
    return Splines(control, splines.duration)


def room(barrier: ControlBarrier, splines: Splines) -> np.ndarray:
    """Least clearance at the samples beyond the margin: [M]."""
    position, _, _ = BASIS.states(splines)
    x, y = np.moveaxis(position, -1, 0)
    return (barrier.clearance.sample(x, y) - barrier.margin).min(-1)


def test_the_barrier_is_a_lower_bound_of_every_samples_room(barrier: ControlBarrier) -> None:
    splines = bows([0.3, 0.6, -0.8, 1.5])
    h, _ = barrier.value_and_gradient(splines.control)
    below = room(barrier, splines) - h
    assert (below >= 0).all()
    assert (below <= np.log(64) / SHARPNESS).all()


def test_the_gradient_equals_finite_differences(barrier: ControlBarrier) -> None:
    control, h = bows([0.3, 0.6, -0.8]).control, 1e-6
    _, gradient = barrier.value_and_gradient(control)
    rng = np.random.default_rng(0)
    for _ in range(5):
        step = np.zeros_like(control)
        step[..., BASIS.free] = rng.normal(size=gradient.shape)
        ahead, behind = (barrier.value_and_gradient(control + s * h * step)[0] for s in (1, -1))
        slope = (gradient * step[..., BASIS.free]).sum((0, 2))
        np.testing.assert_allclose((ahead - behind) / (2 * h), slope, rtol=1e-5, atol=1e-7)


def test_a_correction_is_the_closed_form(
    barrier: ControlBarrier, monkeypatch: pytest.MonkeyPatch
) -> None:
    """h climbs by its shortfall, up to the slack, by the least change in the metric."""
    monkeypatch.setattr(control_barrier, "CORRECTIONS", 1)
    splines = bows([0.5])
    (h,), gradient = barrier.value_and_gradient(splines.control)
    root = whitening(BASIS).astype(np.float64)
    change = (barrier.corrected(splines).control - splines.control)[:, 0, BASIS.free]
    noise = np.linalg.solve(root, change.T).T  # in coordinates in which the metric is round
    slope = gradient[:, 0] @ root
    variance = (slope**2).sum()
    assert h < -0.1
    np.testing.assert_allclose(noise, -h * slope / (variance + SLACK**2), rtol=1e-4, atol=1e-6)


def test_what_is_near_is_moved_clear_and_ends_and_durations_stay(barrier: ControlBarrier) -> None:
    splines = bows([0.45, 0.6, -0.5, 1.5])
    assert (room(barrier, splines) < 0).tolist() == [True, True, True, False]
    corrected = barrier.corrected(splines)
    assert (room(barrier, corrected) > -0.01).all()
    np.testing.assert_array_equal(corrected.control[:, 3], splines.control[:, 3])
    fixed = np.r_[0:3, -2:0]
    np.testing.assert_array_equal(corrected.control[..., fixed], splines.control[..., fixed])
    np.testing.assert_array_equal(corrected.duration, splines.duration)


def test_one_correction_after_another_frees_a_path_between_two_posts() -> None:
    """A first one sees little but the post that is deeper in the way."""
    occupied = np.zeros((64, 64), bool)
    occupied[33:42, 18:22] = occupied[18:30, 42:46] = True
    field = GridField(clearance_field(occupied, 0.1, 0.25), 0.1, np.zeros(2))
    barrier, splines = ControlBarrier(BASIS, field, 0.1), bows([0.0])
    assert room(barrier, splines)[0] < -0.2
    assert room(barrier, barrier.corrected(splines))[0] > 0.0


def test_a_heading_stays(barrier: ControlBarrier) -> None:
    planar = bows([0.5, -0.5])
    heading = np.random.default_rng(1).normal(size=planar.control[:1].shape)
    turning = Splines(np.concatenate([planar.control, heading]), planar.duration)
    corrected = barrier.corrected(turning).control
    np.testing.assert_array_equal(corrected[2:], heading)
    np.testing.assert_allclose(corrected[:2], barrier.corrected(planar).control, atol=1e-12)
