"""The hand-written gradient equals finite differences, and descent does what it is for."""

import numpy as np
import pytest

from anchorflow_trajectory.clearance import clearance_field, path_clearance
from anchorflow_trajectory.cost import MotionLimits, TrajectoryCost
from anchorflow_trajectory.cost_fields import CostFields
from anchorflow_trajectory.descent import descend
from anchorflow_trajectory.spline import spline_basis

LIMITS = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=8.0)
X_CURR = np.asarray([1.0, 3.2, 0.4, 0.0, 0.0, 0.0], np.float32)
X_GOAL = np.asarray([5.5, 3.1, 0.0, 0.0], np.float32)
BASIS = spline_basis(64, 8.0)


def fields(*, risky: bool = False) -> CostFields:
    """A post in the way and, if asked for, risky ground below it."""
    occupied = np.zeros((64, 64), bool)
    occupied[30:34, 31:35] = True
    cost_map = np.zeros((3, 64, 64), np.float32)
    cost_map[0], cost_map[1] = occupied, 1.0
    if risky:
        cost_map[2] = np.linspace(1.0, 0.0, 64)[:, None]
    return CostFields.of(cost_map, clearance_field(occupied, 0.1, 0.25), 0.1, np.zeros(2))


def cost(
    style: tuple[float, float, float] = (0.4, 0.3, 0.3), *, risky: bool = False
) -> TrajectoryCost:
    return TrajectoryCost(BASIS, fields(risky=risky), LIMITS, np.asarray(style, np.float32))


def disturbed(count: int, spread: float = 0.4) -> np.ndarray:
    rng = np.random.default_rng(3)
    control = np.repeat(BASIS.rest_curve(X_CURR, X_GOAL)[:, None], count, axis=1)
    free = control[..., BASIS.free]
    # Least at the ends, where the control points lie close and a shift is a jolt.
    free += rng.normal(0.0, spread, free.shape) * np.sin(np.linspace(0.0, np.pi, free.shape[-1]))
    return control.astype(np.float64)


@pytest.mark.parametrize("risky", [False, True])
def test_gradient_equals_finite_differences(risky: bool) -> None:
    control, h = disturbed(4, spread=1.0), 1e-4
    _, gradient = cost(risky=risky).value_and_gradient(control)
    rng = np.random.default_rng(5)
    for _ in range(5):
        direction = rng.normal(size=control.shape)
        ahead, behind = (cost(risky=risky).value(control + s * h * direction) for s in (1, -1))
        slope = (gradient * direction).sum((0, 2))
        np.testing.assert_allclose((ahead - behind) / (2 * h), slope, rtol=0.05, atol=0.3)


def test_descent_frees_anchors_and_keeps_the_ends_and_the_limits() -> None:
    problem, start = cost(), disturbed(32).astype(np.float32)
    control = descend(problem, start, steps=60, rate=0.3)
    assert (problem.value(control) < problem.value(start)).all()
    position, velocity, acceleration = BASIS.states(control)
    clearance = path_clearance(problem.fields.clearance, position, max_step=0.02)
    assert (clearance > 0).mean() > 0.9
    assert np.linalg.norm(velocity, axis=-1).max() <= 1.02 * LIMITS.v_max
    assert np.linalg.norm(acceleration, axis=-1).max() <= 1.03 * LIMITS.a_max
    np.testing.assert_allclose(position[:, 0], np.tile(X_CURR[:2], (32, 1)), atol=1e-4)
    np.testing.assert_allclose(position[:, -1], np.tile(X_GOAL[:2], (32, 1)), atol=1e-4)


def test_descent_leaves_a_heading_where_it_was() -> None:
    planar = disturbed(8).astype(np.float32)
    heading = np.random.default_rng(4).normal(0.0, 0.3, planar[:1].shape).astype(np.float32)
    control = descend(cost(), np.concatenate([planar, heading]), steps=20, rate=0.3)
    np.testing.assert_array_equal(control[2:], heading)
    # All three dimensions share a product, so sums may be rounded differently.
    np.testing.assert_allclose(control[:2], descend(cost(), planar, steps=20, rate=0.3), atol=1e-3)


def test_one_trajectory_never_touches_another() -> None:
    start = disturbed(8).astype(np.float32)
    together = descend(cost(), start, steps=20, rate=0.3)
    alone = descend(cost(), start[:, 3:4], steps=20, rate=0.3)
    np.testing.assert_allclose(together[:, 3:4], alone, atol=1e-4)


def test_each_style_is_visible() -> None:
    start = disturbed(32).astype(np.float32)

    def finished(style: tuple[float, float, float]) -> tuple[float, float, float]:
        problem = cost(style)
        control = descend(problem, start, steps=80, rate=0.3)
        position, _, _ = BASIS.states(control)
        clearance = path_clearance(problem.fields.clearance, position, max_step=0.02)
        length = np.linalg.norm(np.diff(position, axis=1), axis=-1).sum(1)
        jerk = np.linalg.norm(control.transpose(1, 0, 2) @ BASIS.jerk.T, axis=1).mean(1)
        return float(clearance.mean()), float(length.mean()), float(jerk.mean())

    safe, energetic, smooth = (finished(s) for s in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    assert safe[0] > 1.2 * energetic[0]
    assert energetic[1] < safe[1]
    assert smooth[2] < 0.9 * min(safe[2], energetic[2])


def test_risky_ground_is_avoided() -> None:
    start = disturbed(16).astype(np.float32)
    plain, risky = (
        BASIS.states(descend(cost((0.8, 0.1, 0.1), risky=r), start, steps=60, rate=0.3))[0]
        for r in (False, True)
    )
    assert risky[..., 1].mean() > plain[..., 1].mean() + 0.1
