"""What tests of costs, descents and finishes share: a map with a post, and curves past it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.cost.fields import CostFields
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.spline.basis import Ends, SplineBasis, Splines, spline_basis

LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
MOVING = Ends(np.array([1.0, 3.2, 0.4, 0.1, 0.2, -0.3]), np.array([5.5, 3.1, 0.3, -0.1]))
AT_REST = Ends(np.array([1.0, 3.2, 0, 0, 0, 0.0]), np.array([5.5, 3.1, 0, 0.0]))


@dataclass(frozen=True)
class Stage:
    """6.4 x 6.4 m with a post half way between both ends, 4.5 m apart."""

    basis: SplineBasis
    limits: MotionLimits
    moving: Ends
    at_rest: Ends

    def fields(self, *, risky: bool = False) -> CostFields:
        """The post and, optionally, dear ground below it, more of it to the right."""
        occupied = np.zeros((64, 64), bool)
        occupied[30:34, 31:35] = True
        clearance = GridField(clearance_field(occupied, 0.1, 0.25), 0.1, np.zeros(2))
        if not risky:
            return CostFields(clearance)
        surcharge = 3.0 * np.linspace(1.0, 0.0, 64)[:, None] * np.linspace(0.6, 1.0, 64)
        return CostFields(clearance, GridField(surcharge.astype(np.float32), 0.1, np.zeros(2)))

    def disturbed(
        self, count: int, ends: Ends, *, spread: float = 0.4, duration: float = 4.0
    ) -> Splines:
        """Disturbed curves between the ends, of durations about the one that is given."""
        rng = np.random.default_rng(3)
        splines = self.basis.rest_curves(ends, duration * np.exp(rng.normal(0.0, 0.3, count)))
        control = splines.control.astype(np.float64)
        free = control[..., self.basis.free]
        # Least at the ends: control points are dense there, and a shift is a jolt.
        bulge = np.sin(np.linspace(0.0, np.pi, free.shape[-1]))
        free += rng.normal(0.0, spread, free.shape) * bulge
        return Splines(control, splines.duration.astype(np.float32).astype(np.float64))


@pytest.fixture(scope="session")
def stage() -> Stage:
    return Stage(spline_basis(64), LIMITS, MOVING, AT_REST)
