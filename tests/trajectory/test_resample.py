"""Known trajectories at other time steps."""

import numpy as np
import pytest

from anchorflow_trajectory.resample import resampled_states, whole_fields

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


def test_columns_are_whole_fields() -> None:
    assert [c for c in range(12) if whole_fields(c, 2)] == [2, 4, 6]
    assert [c for c in range(12) if whole_fields(c, 3)] == [3, 6, 9]
