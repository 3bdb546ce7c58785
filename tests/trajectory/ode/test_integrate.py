"""Integration: orders of convergence, closed forms, the plain reference, and the prior's draws."""

import math
from itertools import pairwise

import numpy as np
import pytest

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE, uniform_schedule
from anchorflow_trajectory.ode.integrate import (
    Array,
    VectorField,
    drawn,
    integrate,
    integrate_in,
    integrate_plainly,
)
from anchorflow_trajectory.ode.methods import METHODS, RK4, ButcherTableau, Method
from anchorflow_trajectory.ode.schedule import stage_times

EACH_METHOD = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
ONE_STEP = [method for method in METHODS.values() if isinstance(method, ButcherTableau)]


def logistic(method: Method, schedule: tuple[float, ...]) -> VectorField:
    """dx/dt = 3 (1 + t) x (1 - x): nonlinear, time-dependent, and solved in closed form."""
    times = stage_times(method, schedule).times

    def vector_field(x: Array, time_index: int, out: Array) -> None:
        np.multiply(x, 1.0 - x, out=out)
        out *= 3.0 * (1.0 + float(times[time_index]))

    return vector_field


@EACH_METHOD
def test_order_of_convergence(method: Method) -> None:
    x0 = np.array([0.1, 0.3, 0.5])
    exact = 1.0 / (1.0 + (1.0 / x0 - 1.0) * np.exp(-4.5))  # the integral of 3 (1 + t) is 4.5
    steps = np.array([8, 16, 32, 64])
    errors = []
    for schedule in map(uniform_schedule, steps):
        x1 = integrate(logistic(method, schedule), x0, schedule=schedule, method=method)
        errors.append(np.abs(x1 - exact).max())
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(method.order, abs=0.25)


@pytest.mark.parametrize("method", ONE_STEP, ids=lambda method: method.name)
def test_linear_field_has_the_methods_own_closed_form(method: Method) -> None:
    """On dx/dt = λx a step multiplies x by the Taylor series of exp(λh) up to the order."""
    rate = -1.7
    x0 = np.array([[1.0, -2.0]])
    series = [1.0, 1.0, 1 / 2, 1 / 6, 1 / 24][: method.order + 1]
    growth = [
        sum(a * (rate * (end - start)) ** k for k, a in enumerate(series))
        for start, end in pairwise(EIGHT_STEP_SCHEDULE)
    ]
    got = integrate(
        lambda x, time_index, out: np.multiply(x, rate, out=out),  # noqa: ARG005
        x0,
        schedule=EIGHT_STEP_SCHEDULE,
        method=method,
    )
    np.testing.assert_allclose(got, x0 * np.prod(growth), rtol=1e-13)


@EACH_METHOD
def test_constant_field_is_exact_in_float32(method: Method) -> None:
    """The straight flow x1 - x0 of a point target is followed without error on any schedule."""
    rng = np.random.default_rng(0)
    x0, x1 = rng.standard_normal((2, 3, 5)).astype(np.float32)
    kept = x0.copy()
    got = integrate(
        lambda x, time_index, out: np.subtract(x1, x0, out=out),  # noqa: ARG005
        x0,
        schedule=EIGHT_STEP_SCHEDULE,
        method=method,
    )
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, x1, atol=1e-6)
    np.testing.assert_array_equal(x0, kept)


class Boxes:
    """States that no array library knows: a list of one number each, nothing in it at first."""

    def empty(self) -> list[float]:
        return []

    def add_scaled(
        self, x: list[float], slope: list[float], weight: float, *, out: list[float]
    ) -> None:
        assert out is not slope
        out[:] = [x[0] + weight * slope[0]]


@EACH_METHOD
def test_the_loop_is_the_same_wherever_states_are_kept(method: Method) -> None:
    """Each step is equal to the last bit; a state read before it is written would be empty."""
    schedule, start = EIGHT_STEP_SCHEDULE, [0.3]
    in_array = logistic(method, schedule)

    def in_box(x: list[float], time_index: int, out: list[float]) -> None:
        slope = np.empty(1)
        in_array(np.array(x), time_index, slope)
        out[:] = slope.tolist()

    arrays: list[float] = []
    boxes: list[float] = []
    integrate(
        in_array,
        np.array(start),
        schedule=schedule,
        method=method,
        on_step=lambda x: arrays.extend(x.tolist()),
    )
    last = integrate_in(
        Boxes(), in_box, start, schedule=schedule, method=method, on_step=boxes.extend
    )
    assert boxes == arrays
    assert len(boxes) == 8
    assert (last, start) == (boxes[-1:], [0.3])


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


def test_draws_are_the_product_row_by_row() -> None:
    rng = np.random.default_rng(0)
    noise, basis = (rng.normal(size=shape).astype(np.float32) for shape in ((70, 27), (27, 448)))
    draws = drawn(noise, basis)
    expected = noise.astype(np.float64) @ basis.astype(np.float64)
    np.testing.assert_allclose(draws, expected, atol=1e-5, rtol=0)
    np.testing.assert_array_equal(drawn(noise[5:6], basis), draws[5:6])
