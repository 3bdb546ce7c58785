"""Noise levels and the deterministic step between them, against closed forms."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from anchorflow_trajectory.ode.ddim import CLEAN, NoiseLevels, ddim_step, noised

SIGNAL = NoiseLevels().signal


def test_the_published_levels() -> None:
    assert SIGNAL.shape == (1000,)
    assert SIGNAL[0] == pytest.approx(1 - 1e-4)
    # sqrt(beta) rises linearly: beta_1 by hand.
    root = math.sqrt(1e-4) + (math.sqrt(0.02) - math.sqrt(1e-4)) / 999
    assert SIGNAL[1] == pytest.approx((1 - 1e-4) * (1 - root**2))
    assert SIGNAL[-1] < 0.01
    assert (np.diff(SIGNAL) < 0).all()


def test_steps_follow_one_noise_where_the_data_are_known() -> None:
    # Given the true x_0, each level of the path is the data with the same noise, whatever the
    # number of steps.
    x_0, noise = np.array([0.3, -0.7]), np.array([1.5, 0.2])
    x = noised(x_0, noise, float(SIGNAL[900]))
    for level, after in pairwise((900, 400, 50, 8)):
        x = ddim_step(x, x_0, float(SIGNAL[level]), following=float(SIGNAL[after]))
        np.testing.assert_allclose(x, noised(x_0, noise, float(SIGNAL[after])), atol=1e-12)
    np.testing.assert_allclose(ddim_step(x, x_0, float(SIGNAL[8]), following=CLEAN), x_0)


@pytest.mark.parametrize("times", [(), (3, 3), (0, 10), (1000, 0), (5, -1)])
def test_times_fall_within_the_levels(times: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected falling times from 999 to 0"):
        NoiseLevels().check_times(times)


@pytest.mark.parametrize("wrong", [{"levels": 0}, {"first": 0.0}, {"first": 0.1}, {"last": 1.0}])
def test_levels_that_are_none(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="expected"):
        NoiseLevels(**wrong)  # pyright: ignore[reportArgumentType] - what is wrong is its value
