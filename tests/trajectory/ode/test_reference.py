"""The plain reference is the textbook's, and the fast integrator does its work."""

import math

import numpy as np
import pytest

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE
from anchorflow_trajectory.ode.integrate import Array, integrate, integrate_plainly
from anchorflow_trajectory.ode.methods import METHODS, RK4, Method
from anchorflow_trajectory.ode.schedule import stage_times

EACH_METHOD = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)


def test_it_is_classical_rk4() -> None:
    """On x' = x one step multiplies by the exponential's series up to h^4."""
    x = integrate_plainly(lambda x, _: x, np.ones(2), schedule=(0.0, 0.5, 1.0), method=RK4)
    step = sum(0.5**k / math.factorial(k) for k in range(5))
    np.testing.assert_allclose(x, step**2)


def test_it_asks_for_the_stages_times() -> None:
    times: list[float] = []
    integrate_plainly(
        lambda x, t: times.append(t) or x, np.ones(1), schedule=(0.0, 0.8, 1.0), method=RK4
    )
    assert times == pytest.approx([0.0, 0.4, 0.4, 0.8, 0.8, 0.9, 0.9, 1.0])


@EACH_METHOD
def test_the_fast_integrator_agrees_with_it(method: Method) -> None:
    """On a field that is not linear and depends on the time."""
    times = stage_times(method, EIGHT_STEP_SCHEDULE).times

    def slope(x: Array, t: float) -> Array:
        return 3.0 * (1.0 + t) * x * (1.0 - x)

    def fast(x: Array, time_index: int, out: Array) -> None:
        out[...] = slope(x, float(times[time_index]))

    x_0 = np.random.default_rng(0).uniform(0.1, 0.9, (3, 5))
    plain = integrate_plainly(slope, x_0, schedule=EIGHT_STEP_SCHEDULE, method=method)
    got = integrate(fast, x_0, schedule=EIGHT_STEP_SCHEDULE, method=method)
    assert np.abs(plain - x_0).max() > 0.2
    np.testing.assert_allclose(got, plain, atol=1e-6)  # flow times are float32 in the fast one
