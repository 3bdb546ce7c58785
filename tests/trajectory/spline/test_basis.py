"""Splines meet their ends, agree with their derivatives and reproduce what they can represent."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from anchorflow_trajectory.spline.basis import (
    Ends,
    SplineBasis,
    Splines,
    basis_functions,
    spline_basis,
)

ENDS = Ends(np.array([1.0, -2.0, 0.5, 0.3, -0.2, 0.1], np.float32), np.array([4.0, 1.0, -0.3, 0.2]))
DURATION = np.array([0.6, 2.0, 5.0, 8.0, 30.0])


@pytest.fixture
def basis() -> SplineBasis:
    return spline_basis(64)


@pytest.fixture
def splines(basis: SplineBasis) -> Splines:
    """Five of different durations, with random free control points between the ends."""
    rng = np.random.default_rng(0)
    control = basis.end_points(ENDS, DURATION)
    control[..., basis.free] += rng.normal(size=control[..., basis.free].shape)
    return Splines(control, DURATION)


@pytest.mark.parametrize("degree", [3, 4, 5])
@pytest.mark.parametrize("derivative", range(4))
def test_basis_functions_are_those_of_a_clamped_uniform_b_spline(
    degree: int, derivative: int
) -> None:
    count, times = 18, np.linspace(0.0, 1.0, 61)
    inner = np.linspace(0.0, 1.0, count - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    found = basis_functions(knots, degree, times, derivative=derivative)
    expected = BSpline(knots, np.eye(count), degree)(times, nu=derivative)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_ends_are_met_in_every_duration(basis: SplineBasis, splines: Splines) -> None:
    """Compared to the resolution of float32 control points: derivatives amplify their rounding."""
    position, velocity, acceleration = basis.states(splines)
    start, goal = ENDS.x_curr.reshape(3, 2), ENDS.x_goal.reshape(2, 2)
    for samples, order, expected in (
        (position[:, 0], 0, start[0]),
        (velocity[:, 0], 1, start[1]),
        (acceleration[:, 0], 2, start[2]),
        (position[:, -1], 0, goal[0]),
        (velocity[:, -1], 1, goal[1]),
    ):
        rounding = np.array([1e-6, 2e-5, 6e-4])[order] / DURATION[:, None] ** order
        assert (np.abs(samples - expected) < rounding + 1e-6).all()


def test_velocity_and_acceleration_are_the_derivatives(splines: Splines) -> None:
    fine = spline_basis(4001)
    position, velocity, acceleration = fine.states(
        Splines(splines.control.astype(np.float64), DURATION)
    )
    for m, duration in enumerate(DURATION):
        dt = duration / 4000
        slope, bend = (np.gradient(x[m], dt, axis=0)[1:-1] for x in (position, velocity))
        assert np.abs(slope - velocity[m, 1:-1]).max() < 2e-3 * np.abs(velocity[m]).max()
        assert np.abs(bend - acceleration[m, 1:-1]).max() < 1e-2 * np.abs(acceleration[m]).max()


def test_a_uniform_motion_is_the_spline_of_its_duration(basis: SplineBasis) -> None:
    """p(t) = v t: control points at the Greville abscissae times v d, whatever the duration."""
    v = np.array([0.5, -0.25])
    for duration in (1.0, 4.0):
        ends = Ends(np.r_[0.0, 0.0, v, 0.0, 0.0], np.r_[v * duration, v])
        splines = basis.rest_curves(ends, np.array([duration]))
        position, velocity, acceleration = basis.states(splines)
        times = np.linspace(0.0, duration, 64)
        np.testing.assert_allclose(position[0], times[:, None] * v, atol=1e-5)
        np.testing.assert_allclose(velocity[0], np.tile(v, (64, 1)), atol=1e-4)
        np.testing.assert_allclose(acceleration[0], 0.0, atol=1e-3 / duration)


def test_own_time_states_are_those_of_one_second(basis: SplineBasis, splines: Splines) -> None:
    unit = Splines(splines.control, np.ones(5))
    np.testing.assert_allclose(
        basis.own_time_states(splines.control), np.concatenate(basis.states(unit), -1), rtol=1e-6
    )


def test_fit_returns_the_spline_that_made_the_states(basis: SplineBasis, splines: Splines) -> None:
    fitted = basis.fit(basis.own_time_states(splines.control), ENDS, DURATION)
    np.testing.assert_allclose(fitted.control, splines.control, atol=2e-5)
    assert fitted.duration is DURATION


def test_fit_of_positions_alone(basis: SplineBasis, splines: Splines) -> None:
    position, _, _ = basis.states(splines)
    fitted = basis.fit_positions(position, ENDS, DURATION)
    np.testing.assert_allclose(fitted.control, splines.control, atol=2e-5)


def test_end_slopes_are_the_derivative_by_log_duration(basis: SplineBasis) -> None:
    h = 1e-3
    ahead, behind = (basis.end_points(ENDS, DURATION * np.exp(s * h)) for s in (1, -1))
    slopes = basis.end_slopes(ENDS, DURATION)
    difference = (ahead.astype(np.float64) - behind) / (2 * h)
    np.testing.assert_allclose(difference, slopes, atol=2e-4 * np.abs(slopes).max())
    assert not slopes[..., basis.free].any()


def test_ends_at_rest_do_not_depend_on_the_duration(basis: SplineBasis) -> None:
    rest = Ends(np.r_[1.0, 2.0, np.zeros(4)], np.r_[3.0, 4.0, 0.0, 0.0])
    assert rest.at_rest
    assert not ENDS.at_rest
    assert not basis.end_slopes(rest, DURATION).any()
    assert (np.ptp(basis.end_points(rest, DURATION), axis=1) == 0.0).all()


def test_a_finer_basis_holds_the_same_curves(basis: SplineBasis, splines: Splines) -> None:
    finer = basis.finer
    assert finer is not None
    assert finer.num_control_points - finer.degree == 2 * (basis.num_control_points - basis.degree)

    for found, wanted in zip(
        finer.states(basis.refined(splines)), basis.states(splines), strict=True
    ):
        np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_no_basis_is_finer_than_its_samples_tell() -> None:
    assert spline_basis(57).finer is not None
    assert spline_basis(56).finer is None


def test_rest_curves_have_the_least_jerk(basis: SplineBasis, splines: Splines) -> None:
    rest = basis.rest_curves(ENDS, DURATION)

    def jerk(control: np.ndarray) -> np.ndarray:
        return ((control @ basis.jerk.T.astype(np.float64)) ** 2).sum((0, 2))

    for share in (1.0, 0.01):
        moved = rest.control + share * (splines.control - rest.control)
        assert (jerk(moved) > jerk(rest.control)).all()


def test_a_third_dimension_is_carried_along() -> None:
    basis = spline_basis(32)
    ends = Ends(np.arange(9, dtype=np.float32), np.arange(6, dtype=np.float32))
    position, velocity, _ = basis.states(basis.rest_curves(ends, np.array([4.0])))
    assert position.shape == (1, 32, 3)
    np.testing.assert_allclose(position[0, 0], ends.x_curr[:3], atol=1e-5)
    np.testing.assert_allclose(velocity[0, -1], ends.x_goal[3:], atol=1e-5)
