"""Orders of convergence, closed forms and the times of the stages."""

from itertools import pairwise

import numpy as np
import pytest

from anchorflow_service.schedule import check_schedule, remaining, stage_times
from anchorflow_service.solver import Array, VectorField, integrate
from anchorflow_service.tableau import EULER, RK4, TABLEAUS, ButcherTableau

EIGHT_STEP = (0.0, 0.8, 0.85, 0.9, 0.92, 0.94, 0.96, 0.98, 1.0)
METHODS = pytest.mark.parametrize("tableau", TABLEAUS.values(), ids=TABLEAUS)


def uniform(steps: int) -> tuple[float, ...]:
    return tuple(k / steps for k in range(steps + 1))


def logistic(tableau: ButcherTableau, schedule: tuple[float, ...]) -> VectorField:
    """dx/dt = 3 (1 + t) x (1 - x): nonlinear, time-dependent, and solved in closed form."""
    times = stage_times(tableau, schedule).times

    def vector_field(x: Array, time_index: int, out: Array) -> None:
        np.multiply(x, 1.0 - x, out=out)
        out *= 3.0 * (1.0 + float(times[time_index]))

    return vector_field


@METHODS
def test_order_of_convergence(tableau: ButcherTableau) -> None:
    x0 = np.array([0.1, 0.3, 0.5])
    exact = 1.0 / (1.0 + (1.0 / x0 - 1.0) * np.exp(-4.5))  # the integral of 3 (1 + t) is 4.5
    steps = np.array([8, 16, 32, 64])
    errors = [
        np.abs(
            integrate(logistic(tableau, uniform(n)), x0, schedule=uniform(n), tableau=tableau)
            - exact
        ).max()
        for n in steps
    ]
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(tableau.order, abs=0.25)


@METHODS
def test_linear_field_has_the_methods_own_closed_form(tableau: ButcherTableau) -> None:
    """On dx/dt = λx a step multiplies x by the Taylor series of exp(λh) up to the order."""
    rate = -1.7
    x0 = np.array([[1.0, -2.0]])
    series = [1.0, 1.0, 1 / 2, 1 / 6, 1 / 24][: tableau.order + 1]
    growth = [
        sum(a * (rate * (end - start)) ** k for k, a in enumerate(series))
        for start, end in pairwise(EIGHT_STEP)
    ]
    got = integrate(
        lambda x, time_index, out: np.multiply(x, rate, out=out),  # noqa: ARG005
        x0,
        schedule=EIGHT_STEP,
        tableau=tableau,
    )
    np.testing.assert_allclose(got, x0 * np.prod(growth), rtol=1e-13)


@METHODS
def test_constant_field_is_exact_in_float32(tableau: ButcherTableau) -> None:
    """The straight flow x1 - x0 of a point target is followed without error on any schedule."""
    rng = np.random.default_rng(0)
    x0, x1 = rng.standard_normal((2, 3, 5)).astype(np.float32)
    kept = x0.copy()
    got = integrate(
        lambda x, time_index, out: np.subtract(x1, x0, out=out),  # noqa: ARG005
        x0,
        schedule=EIGHT_STEP,
        tableau=tableau,
    )
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, x1, atol=1e-6)
    np.testing.assert_array_equal(x0, kept)


def test_rk4_on_eight_steps_has_seventeen_distinct_times() -> None:
    plan = stage_times(RK4, EIGHT_STEP)
    assert plan.times.shape == (17,)
    assert plan.times.dtype == np.float32
    assert (np.diff(plan.times) > 0).all()
    assert plan.index[0] == (0, 1, 1, 2)
    assert plan.index[-1] == (14, 15, 15, 16)


@METHODS
@pytest.mark.parametrize("schedule", [EIGHT_STEP, uniform(7)], ids=["8step", "uniform"])
def test_stage_times_are_where_the_method_says(
    tableau: ButcherTableau, schedule: tuple[float, ...]
) -> None:
    plan = stage_times(tableau, schedule)
    expected = [[t + c * (e - t) for c in tableau.c] for t, e in pairwise(schedule)]
    np.testing.assert_allclose(plan.times[np.array(plan.index)], expected, atol=1e-7)


def test_euler_never_evaluates_at_the_end() -> None:
    assert stage_times(EULER, uniform(4)).times.tolist() == [0.0, 0.25, 0.5, 0.75]


@pytest.mark.parametrize(
    "schedule", [(1.0,), (0.0, 0.5, 0.5, 1.0), (0.0, 0.9), (0.5, 0.2, 1.0), (-0.1, 1.0)]
)
def test_schedules_that_do_not_rise_to_one_are_refused(schedule: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="strictly rising to 1"):
        check_schedule(schedule)


def test_what_remains_of_a_schedule() -> None:
    assert remaining(EIGHT_STEP, 0.8) == EIGHT_STEP[1:]
    assert remaining(EIGHT_STEP, 0.91) == (0.91, *EIGHT_STEP[4:])
