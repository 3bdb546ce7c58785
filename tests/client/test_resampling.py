"""An anchor at a controller's period, against motions in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from anchorflow_client import resample

CUBIC = np.array([[1.0, -2.0], [0.5, 1.0], [-0.75, 0.25], [0.125, -0.5]])
"""[4,2]: coefficients of 1, t, t^2, t^3 in x and y."""


def cubic(times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration [K,2]."""
    t, zero, one = times[:, None], np.zeros((len(times), 1)), np.ones((len(times), 1))
    return (
        np.hstack([one, t, t**2, t**3]) @ CUBIC,
        np.hstack([zero, one, 2 * t, 3 * t**2]) @ CUBIC,
        np.hstack([zero, zero, 2 * one, 6 * t]) @ CUBIC,
    )


@given(st.integers(2, 40), st.floats(0.01, 0.5), st.floats(0.003, 2.0))
def test_a_cubic_comes_back_at_any_period(steps: int, dt: float, period_s: float) -> None:
    anchor = resample(*cubic(dt * np.arange(steps)), dt=dt, period_s=period_s)

    for got, exact in zip(anchor[1:], cubic(anchor.times), strict=True):
        np.testing.assert_allclose(got, exact, rtol=1e-6, atol=1e-6 * (1 + np.abs(exact).max()))


@given(st.integers(2, 40), st.floats(0.01, 0.5), st.floats(0.003, 2.0))
def test_its_times_are_multiples_of_the_period_and_the_end(
    steps: int, dt: float, period_s: float
) -> None:
    times = resample(*cubic(dt * np.arange(steps)), dt=dt, period_s=period_s).times

    np.testing.assert_allclose(times[:-1], period_s * np.arange(len(times) - 1), atol=1e-9)
    assert times[-1] == pytest.approx(dt * (steps - 1), rel=1e-9)
    assert (np.diff(times) > 0).all()
    assert np.diff(times)[-1] <= period_s * (1 + 1e-6)


@pytest.mark.parametrize(
    ("dt", "steps", "period_s", "times"),
    [
        (0.1, 4, 0.1, [0.0, 0.1, 0.2, 0.3]),  # 3 x 0.1 is not 0.3 in floating point
        (0.1, 4, 0.15, [0.0, 0.15, 0.3]),
        (0.1, 4, 0.2, [0.0, 0.2, 0.3]),
        (0.1, 4, 1.0, [0.0, 0.3]),
        (0.1, 11, 0.05, np.arange(21) * 0.05),
    ],
)
def test_the_end_is_there_once(dt: float, steps: int, period_s: float, times: Any) -> None:
    anchor = resample(*cubic(dt * np.arange(steps)), dt=dt, period_s=period_s)

    np.testing.assert_allclose(anchor.times, times, atol=1e-12)


def test_at_its_own_period_it_is_the_anchor() -> None:
    motion = np.random.default_rng(0).normal(size=(3, 9, 2))

    anchor = resample(*motion, dt=0.25, period_s=0.25)

    for got, given_ in zip(anchor[1:], motion, strict=True):
        np.testing.assert_allclose(got, given_, atol=1e-12)


def test_the_error_falls_with_the_fourth_power_of_the_time_step() -> None:
    def error(dt: float) -> float:
        times = np.arange(0, 2 * np.pi + dt / 2, dt)
        motion = (np.stack([f(times), times], axis=1) for f in (np.sin, np.cos, _minus_sin))
        anchor = resample(*motion, dt=dt, period_s=dt / 7)
        return float(np.abs(anchor.positions[:, 0] - np.sin(anchor.times)).max())

    def order(coarse: int) -> float:
        return float(np.log2(error(np.pi / coarse) / error(np.pi / (2 * coarse))))

    assert order(16) == pytest.approx(4.0, abs=0.1)
    assert error(np.pi / 16) <= (np.pi / 16) ** 4 / 384  # as its docstring says, |p''''| = 1


def _minus_sin(times: np.ndarray) -> np.ndarray:
    return -np.sin(times)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"positions": np.zeros((1, 2))}, r"positions: expected shape \[T,D\], T at least 2"),
        ({"positions": np.zeros((2, 4, 2))}, r"positions: expected shape \[T,D\].*\[2, 4, 2\]"),
        ({"velocities": np.zeros((4, 3))}, r"velocities: expected shape \[4, 2\], got \[4, 3\]"),
        ({"accelerations": np.zeros((3, 2))}, r"accelerations: expected shape \[4, 2\]"),
        ({"dt": 0.0}, "dt: expected s above 0, got 0"),
        ({"dt": "x"}, "dt: expected s above 0, got x"),
        ({"period_s": np.nan}, "period_s: expected s above 0, got nan"),
    ],
)
def test_what_is_no_anchor_is_refused(changes: dict[str, Any], words: str) -> None:
    given_ = {name: np.zeros((4, 2)) for name in ("positions", "velocities", "accelerations")}

    with pytest.raises(ValueError, match=words):
        resample(**{**given_, "dt": 0.1, "period_s": 0.05} | changes)
