"""Splines meet their ends, agree with their derivatives and reproduce what they can represent."""

import numpy as np
import pytest

from anchorflow_trajectory.spline import SplineBasis, spline_basis

X_CURR = np.array([1.0, -2.0, 0.5, 0.3, -0.2, 0.1], np.float32)
X_GOAL = np.array([4.0, 1.0, -0.3, 0.2], np.float32)


@pytest.fixture
def basis() -> SplineBasis:
    return spline_basis(64, 8.0)


@pytest.fixture
def control(basis: SplineBasis) -> np.ndarray:
    """Random free control points [2, 5, K] between the ends."""
    rng = np.random.default_rng(0)
    control = np.repeat(basis.end_points(X_CURR, X_GOAL)[:, None], 5, axis=1)
    control[..., basis.free] += rng.normal(size=control[..., basis.free].shape)
    return control.astype(np.float32)


def test_ends_are_met_whatever_the_free_points(basis: SplineBasis, control: np.ndarray) -> None:
    position, velocity, acceleration = basis.states(control)
    start = np.concatenate([s[:, 0] for s in (position, velocity, acceleration)], -1)
    goal = np.concatenate([position[:, -1], velocity[:, -1]], -1)
    np.testing.assert_allclose(start, np.tile(X_CURR, (5, 1)), atol=2e-5)
    np.testing.assert_allclose(goal, np.tile(X_GOAL, (5, 1)), atol=2e-5)


def test_velocity_and_acceleration_are_the_derivatives(control: np.ndarray) -> None:
    fine = spline_basis(4001, 8.0)
    position, velocity, acceleration = fine.states(control.astype(np.float64))
    dt = 8.0 / 4000
    np.testing.assert_allclose(
        np.gradient(position, dt, axis=1)[:, 1:-1], velocity[:, 1:-1], atol=2e-3
    )
    np.testing.assert_allclose(
        np.gradient(velocity, dt, axis=1)[:, 1:-1], acceleration[:, 1:-1], atol=1e-2
    )


def test_fit_returns_the_spline_that_made_the_states(
    basis: SplineBasis, control: np.ndarray
) -> None:
    state = np.concatenate(basis.states(control), -1)
    np.testing.assert_allclose(basis.fit(state, X_CURR, X_GOAL), control, atol=1e-5)


def test_fit_of_positions_alone(basis: SplineBasis, control: np.ndarray) -> None:
    position, _, _ = basis.states(control)
    np.testing.assert_allclose(basis.fit_positions(position, X_CURR, X_GOAL), control, atol=1e-5)


def test_rest_curve_has_the_least_jerk(basis: SplineBasis, control: np.ndarray) -> None:
    rest = basis.rest_curve(X_CURR, X_GOAL)

    def jerk(points: np.ndarray) -> float:
        return float(((points @ basis.jerk.T) ** 2).sum())

    moved = rest.copy()
    for change in (control[:, 0] - rest, 0.01 * (control[:, 1] - rest)):
        moved[:, basis.free] = (rest + change)[:, basis.free]
        assert jerk(moved) > jerk(rest)


def test_a_third_dimension_is_carried_along() -> None:
    basis = spline_basis(32, 4.0)
    x_curr, x_goal = np.arange(9, dtype=np.float32), np.arange(6, dtype=np.float32)
    position, velocity, _ = basis.states(basis.rest_curve(x_curr, x_goal)[:, None])
    assert position.shape == (1, 32, 3)
    np.testing.assert_allclose(position[0, 0], x_curr[:3], atol=1e-5)
    np.testing.assert_allclose(velocity[0, -1], x_goal[3:], atol=1e-5)
