"""Methods: tableaus check their order, Adams weights are exact, and names are the contract's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_client import contract
from anchorflow_client.contract import uniform_schedule
from anchorflow_trajectory.ode.methods import (
    AB2,
    EULER,
    HEUN,
    METHODS,
    MIDPOINT,
    RK4,
    AdamsBashforth,
    ButcherTableau,
    method_named,
)

TABLEAUS = (EULER, MIDPOINT, HEUN, RK4)


@pytest.mark.parametrize("tableau", TABLEAUS, ids=lambda tableau: tableau.name)
def test_no_method_claims_less_than_its_order(tableau: ButcherTableau) -> None:
    with pytest.raises(ValueError, match=rf"order {tableau.order + 1}\b"):
        replace(tableau, order=tableau.order + 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"b": (0.3, 0.3, 0.3, 0.3)}, r"Σ b \(order 1\)"),
        ({"b": (0.25, 0.25, 0.25, 0.25)}, r"order 3"),
        ({"c": (0.0, 0.5, 0.6, 1.0)}, "row sums of a"),
        ({"a_lower": ((), (0.5,), (0.25, 0.25), (0.0, 0.0, 1.0))}, r"b·Ac \(order 3\)"),
        ({"a_lower": ((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0))}, "rows of"),
        ({"order": 5}, r"not in 1\.\.4"),
    ],
)
def test_wrong_coefficients_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(RK4, **changes)


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


def test_the_names_are_the_contracts() -> None:
    """The client may not import them, so it says them itself."""
    assert set(METHODS) == set(contract.METHODS)


def test_lookup_by_name() -> None:
    assert method_named("heun") is HEUN
    assert method_named("ab2") is AB2
    with pytest.raises(ValueError, match="expected one of euler, midpoint, heun, rk4, ab2"):
        method_named("rk45")
