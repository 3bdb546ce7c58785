"""Weights of the Adams methods: the textbook's on equal steps, exact for polynomials on others."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_client.contract import uniform_schedule
from anchorflow_trajectory.ode.methods import AdamsBashforth

UNEQUAL = (0.0, 0.1, 0.35, 0.5, 1.0)


@pytest.mark.parametrize(
    ("order", "weights"),
    [(1, [1]), (2, [3 / 2, -1 / 2]), (3, [23 / 12, -16 / 12, 5 / 12])],
)
def test_equal_steps_give_the_textbook_s_weights(order: int, weights: list[float]) -> None:
    method = AdamsBashforth(f"ab{order}", order)
    np.testing.assert_allclose(method.weights(uniform_schedule(5), 3), weights, rtol=1e-12)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_step_is_exact_for_slopes_of_lower_degree(order: int) -> None:
    method = AdamsBashforth("adams", order)
    step, degree = 3, order - 1
    slopes = [time**degree for time in reversed(UNEQUAL[: step + 1])][:order]
    start, end = UNEQUAL[step : step + 2]
    moved = (end - start) * np.dot(method.weights(UNEQUAL, step), slopes)
    exact = (end ** (degree + 1) - start ** (degree + 1)) / (degree + 1)
    assert moved == pytest.approx(exact, rel=1e-12)


def test_the_first_steps_look_back_on_what_there_is() -> None:
    method = AdamsBashforth("ab3", 3)
    assert [len(method.weights(UNEQUAL, step)) for step in range(4)] == [1, 2, 3, 3]
    assert method.weights(UNEQUAL, 0) == (1.0,)
