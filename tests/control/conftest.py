"""Robots of each kind."""

from __future__ import annotations

import pytest

from anchorflow_control import Robot

KINDS = {
    "omni": {},
    "differential": {"omega_max": 2.0},
    "ackermann": {"omega_max": 2.0, "min_turning_radius": 0.6},
}


@pytest.fixture(params=KINDS)
def robot(request: pytest.FixtureRequest) -> Robot:
    """A disc of 0.3 m."""
    return Robot(kind=request.param, v_max=1.0, a_max=1.5, radius=0.3, **KINDS[request.param])
