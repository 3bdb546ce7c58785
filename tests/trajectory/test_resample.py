"""Known trajectories at other time steps."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from anchorflow_trajectory.warm_start import resampled_states, whole_fields

HORIZON_S = 7.0


def parabola(steps: int) -> np.ndarray:
    """States [2, steps, 6] of trajectories that splines represent exactly."""
    t = np.linspace(0.0, HORIZON_S, steps)
    one = np.ones_like(t)
    p, v, a = [0.5 * t**2 - t, 0.1 * t**2], [t - 1.0, 0.2 * t], [one, 0.2 * one]
    states = np.stack([*p, *v, *a], axis=1)
    return np.stack([states, -2 * states])


@pytest.mark.parametrize("columns", [2, 4, 6])
@pytest.mark.parametrize("steps", [4, 8, 31])
def test_missing_derivatives_and_steps_are_filled(steps: int, columns: int) -> None:
    given = parabola(steps)[..., :columns]
    got = resampled_states(given, dim=2, num_steps=8, horizon_s=HORIZON_S)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, parabola(8), atol=1e-5)


@pytest.mark.parametrize("steps", [2, 3, 4, 5, 12, 64])
@pytest.mark.parametrize("num_steps", [2, 7, 64])
def test_splines_are_those_of_scipy(steps: int, num_steps: int) -> None:
    given = np.random.default_rng(steps).normal(size=(3, steps, 2))
    spline = CubicSpline(np.linspace(0.0, HORIZON_S, steps), given, axis=1)
    times = np.linspace(0.0, HORIZON_S, num_steps)

    got = resampled_states(given, dim=2, num_steps=num_steps, horizon_s=HORIZON_S)
    expected = np.concatenate([spline(times, order) for order in range(3)], axis=-1)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6)


def test_columns_are_whole_fields() -> None:
    assert [c for c in range(12) if whole_fields(c, 2)] == [2, 4, 6]
    assert [c for c in range(12) if whole_fields(c, 3)] == [3, 6, 9]
