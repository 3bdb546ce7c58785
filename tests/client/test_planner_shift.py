"""An anchor seen later, against motions in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anchorflow_client.planner.plan import shifted

DT = 0.1


def falling(times: np.ndarray) -> np.ndarray:
    """[T,6]: constant acceleration of 2 m/s^2 along y, 1 m/s along x."""
    t, zero = times, np.zeros_like(times)
    return np.stack([t, t**2, zero + 1, 2 * t, zero, zero + 2], axis=-1)


@pytest.mark.parametrize("steps", [0, 5])
def test_whole_steps_move_the_samples_up(steps: int) -> None:
    times = DT * np.arange(20)
    later = shifted(falling(times), dt=DT, elapsed_s=steps * DT)
    np.testing.assert_allclose(later[:15], falling(times + steps * DT)[:15], atol=1e-12)


@given(st.floats(0.0, 0.9))
def test_between_samples_the_error_is_that_of_a_chord(elapsed_s: float) -> None:
    times = DT * np.arange(20)
    later = shifted(falling(times), dt=DT, elapsed_s=elapsed_s)
    left = times + elapsed_s <= times[-1]
    error = np.abs(later - falling(times + elapsed_s))[left]
    assert error.max() <= 2 * DT**2 / 8 + 1e-9  # |a| dt^2 / 8


def test_past_its_end_the_motion_goes_on_straight() -> None:
    states = falling(DT * np.arange(11))  # ends at (1, 1) with (1, 2) m/s
    later = shifted(states, dt=DT, elapsed_s=1.5)
    np.testing.assert_allclose(later[0], [1.5, 2.0, 1, 2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(later[-1], [2.5, 4.0, 1, 2, 0, 0], atol=1e-12)


@pytest.mark.parametrize("own", [DT, np.array([0.03, 0.1, 0.7])])
def test_anchors_of_a_batch_are_shifted_one_by_one(own: float | np.ndarray) -> None:
    states = np.random.default_rng(0).normal(size=(3, 12, 6))
    together = shifted(states, dt=own, elapsed_s=0.37)
    for one, dt, alone in zip(states, np.broadcast_to(own, 3), together, strict=True):
        np.testing.assert_array_equal(shifted(one, dt=dt, elapsed_s=0.37), alone)


def test_what_is_left_may_be_sampled_up_to_its_end() -> None:
    times = DT * np.arange(11)  # 1 s
    left = shifted(falling(times), dt=DT, elapsed_s=0.4, later_dt=0.06)
    np.testing.assert_allclose(left[[0, -1]], falling(np.array([0.4, 1.0])), atol=1e-9)
    np.testing.assert_allclose(left[5], falling(np.array([0.7]))[0], atol=1e-9)


@given(st.integers(2, 64), st.floats(1e-3, 10.0), st.floats(0.0, 0.999))
def test_the_end_keeps_its_acceleration(steps: int, dt: float, share: float) -> None:
    """However the times are rounded, no sample is past the end."""
    states = falling(dt * np.arange(steps))
    elapsed_s = share * dt * (steps - 1)
    later_dt = (dt * (steps - 1) - elapsed_s) / (steps - 1)
    left = shifted(states, dt=dt, elapsed_s=elapsed_s, later_dt=later_dt)
    np.testing.assert_array_equal(left[:, 4:], states[:, 4:])
    np.testing.assert_allclose(left[-1], states[-1], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_positions_follow_their_own_velocities(dim: int) -> None:
    states = np.zeros((4, 3 * dim))
    states[:, dim : 2 * dim] = np.arange(1, dim + 1)
    later = shifted(states, dt=1.0, elapsed_s=5.0)
    np.testing.assert_allclose(later[0, :dim], 2.0 * np.arange(1, dim + 1))
