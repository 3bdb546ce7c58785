"""Orders of convergence, closed forms and tolerances of the torch integrators."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE, uniform_schedule
from anchorflow_models.generation.integrate import Stage, integrate, integrate_adaptive
from anchorflow_trajectory.ode.methods import METHODS, ButcherTableau, Method
from anchorflow_trajectory.ode.schedule import Schedule, stage_times

EACH_METHOD = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
ONE_STEP = [method for method in METHODS.values() if isinstance(method, ButcherTableau)]
X_0 = torch.tensor([[[0.1, 0.3], [0.5, 0.7]]], dtype=torch.float64)


def slope(t: float | Tensor, x: Tensor) -> Tensor:
    """dx/dt = 3 (1 + t) x (1 - x): nonlinear, time-dependent, and solved in closed form."""
    return 3 * (1 + t) * x * (1 - x)


def exact(x_0: Tensor, start: float = 0.0) -> Tensor:
    growth = 3 * (1.5 - start - start**2 / 2)
    return 1 / (1 + (1 / x_0 - 1) * math.exp(-growth))


def on_schedule(method: Method, schedule: Schedule) -> Callable[[Tensor, Stage], Tensor]:
    times = stage_times(method, schedule).times
    return lambda x, stage: slope(float(times[stage.time_index]), x)


@EACH_METHOD
def test_order_of_convergence(method: Method) -> None:
    steps = np.array([8, 16, 32, 64])
    errors = []
    for schedule in map(uniform_schedule, steps):
        x_1 = integrate(on_schedule(method, schedule), X_0, schedule=schedule, method=method)
        errors.append(float((x_1 - exact(X_0)).abs().max()))
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(method.order, abs=0.25)


@pytest.mark.parametrize("method", ONE_STEP, ids=lambda method: method.name)
def test_linear_field_has_the_methods_own_closed_form(method: Method) -> None:
    """On dx/dt = λx a step multiplies x by the Taylor series of exp(λh) up to the order."""
    rate = -1.7
    series = [1.0, 1.0, 1 / 2, 1 / 6, 1 / 24][: method.order + 1]
    growth = [
        sum(a * (rate * (end - start)) ** k for k, a in enumerate(series))
        for start, end in pairwise(EIGHT_STEP_SCHEDULE)
    ]
    got = integrate(lambda x, _: rate * x, X_0, schedule=EIGHT_STEP_SCHEDULE, method=method)
    torch.testing.assert_close(got, X_0 * math.prod(growth), rtol=1e-13, atol=0)


@EACH_METHOD
def test_each_stage_knows_its_stride(method: Method) -> None:
    seen: list[float] = []

    def field(x: Tensor, stage: Stage) -> Tensor:
        seen.append(stage.stride)
        return x

    integrate(field, X_0, schedule=(0.0, 0.75, 1.0), method=method)
    assert seen == [0.75] * method.stages + [0.25] * method.stages


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_the_adaptive_method_meets_its_tolerance(tolerance: float) -> None:
    evaluations = 0

    def field(t: Tensor, x: Tensor) -> Tensor:
        nonlocal evaluations
        evaluations += 1
        return slope(t, x)

    for start in (0.0, 0.6):
        got = integrate_adaptive(field, X_0, start=start, rtol=tolerance, atol=tolerance)
        assert float((got - exact(X_0, start)).abs().max()) < 5 * tolerance
    # Order 5: a thousandth of the error costs about four times the steps, not a thousand times.
    assert evaluations < 30 * 4 ** (-math.log10(tolerance) / 3)


def test_one_hard_sample_among_many_is_solved_as_if_alone() -> None:
    """Averaged over all samples its error would count for a thousandth."""

    def solved(rates: Tensor) -> Tensor:
        return integrate_adaptive(
            lambda t, x: rates * torch.cos(rates * t) * x,
            torch.ones_like(rates),
            start=0.0,
            rtol=1e-5,
            atol=1e-5,
        )

    hard = torch.full((1, 1, 1), 40.0, dtype=torch.float64)
    among_many = solved(torch.cat([hard, torch.zeros(1, 999, 1, dtype=torch.float64)], 1))
    torch.testing.assert_close(among_many[:, :1], solved(hard), rtol=1e-12, atol=0)


def test_a_tolerance_finer_than_the_numbers_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rtol: expected at least 1\.2e-06 for torch\.float32"):
        integrate_adaptive(slope, X_0.float(), start=0.0, rtol=1e-7, atol=1e-7)
