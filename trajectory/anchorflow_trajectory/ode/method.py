"""The methods of integration, by the names of the contract."""

from __future__ import annotations

from anchorflow_trajectory.ode.multistep import AdamsBashforth
from anchorflow_trajectory.ode.tableau import EULER, HEUN, MIDPOINT, RK4, ButcherTableau

Method = ButcherTableau | AdamsBashforth
"""Stages as a Butcher tableau tells them; a step weighs the slopes of its stages, or older ones."""

AB2 = AdamsBashforth("ab2", order=2)

METHODS: dict[str, Method] = {method.name: method for method in (EULER, MIDPOINT, HEUN, RK4, AB2)}


def method_named(name: str) -> Method:
    """The method of that name; ValueError lists the known ones."""
    try:
        return METHODS[name]
    except KeyError:
        known = ", ".join(METHODS)
        raise ValueError(f"unknown method {name!r}, expected one of {known}") from None
