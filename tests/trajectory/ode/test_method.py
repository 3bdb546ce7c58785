"""Methods go by the contract's names."""

import pytest

from anchorflow_client import contract
from anchorflow_trajectory.ode.methods import AB2, HEUN, METHODS, method_named


def test_the_names_are_the_contracts() -> None:
    """The client may not import them, so it says them itself."""
    assert set(METHODS) == set(contract.METHODS)


def test_lookup_by_name() -> None:
    assert method_named("heun") is HEUN
    assert method_named("ab2") is AB2
    with pytest.raises(ValueError, match="expected one of euler, midpoint, heun, rk4, ab2"):
        method_named("rk45")
