"""A method is data that proves itself."""

from dataclasses import replace

import pytest

from anchorflow_trajectory.ode.methods import EULER, HEUN, MIDPOINT, RK4, ButcherTableau

TABLEAUS = (EULER, MIDPOINT, HEUN, RK4)


def test_rk4_is_the_classical_rule() -> None:
    assert RK4.b == (1 / 6, 1 / 3, 1 / 3, 1 / 6)
    assert RK4.c == (0.0, 0.5, 0.5, 1.0)


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


def test_three_eighths_rule_is_of_order_four_too() -> None:
    rule = ButcherTableau(
        "three-eighths",
        a_lower=((), (1 / 3,), (-1 / 3, 1.0), (1.0, -1.0, 1.0)),
        b=(1 / 8, 3 / 8, 3 / 8, 1 / 8),
        c=(0.0, 1 / 3, 2 / 3, 1.0),
        order=4,
    )
    assert rule.stages == 4
