"""Finish anchors: fit splines that meet both ends, push them clear, and measure what came out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.bisection import bisect_to_safe
from anchorflow_trajectory.cost import MotionLimits, TrajectoryCost
from anchorflow_trajectory.cost_fields import CostFields
from anchorflow_trajectory.descent import descend
from anchorflow_trajectory.spline import SplineBasis, spline_basis
from anchorflow_trajectory.verify import verify

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

DESCENT_RATE = 0.3  # m, a first step on the control points
# Where nothing is safe yet, further descents: a hard scene costs more time than an easy one.
FURTHER_RATES = (0.15, 0.15, 0.15)
STIFFER = 4.0  # by how much obstacles and limits then weigh more, from one to the next


class Refinement(Protocol):
    """What is asked of the finish: the contract's `RefineSpec` is one."""

    @property
    def smooth(self) -> bool:
        """Fit the spline with fixed ends."""
        ...

    @property
    def project(self) -> bool:
        """Push anchors out of obstacles and inside the limits."""
        ...

    @property
    def safety_margin(self) -> float:
        """m of clearance that the projection aims at."""
        ...


@dataclass(frozen=True)
class Refined:
    """Anchors of one scene.

    positions, velocities, accelerations: [N, T, D] in m, m/s, m/s^2
    scores: [N], minus the expert's cost for the requested style; higher is better
    clearance: [N] m beyond robot_radius, smallest along the path
    safe: [N], clear of every obstacle and of the map's edge, and within the limits
    """

    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    scores: FloatArray
    clearance: FloatArray
    safe: BoolArray


@dataclass(frozen=True)
class Refiner:
    """How one bundle's anchors are finished.

    steps: descents on the control points where a request asks to project
    """

    basis: SplineBasis
    limits: MotionLimits
    steps: int

    @staticmethod
    def of(
        limits: MotionLimits, *, num_steps: int, num_control_points: int, degree: int, steps: int
    ) -> Refiner:
        """A refiner for anchors of T = `num_steps` samples."""
        basis = spline_basis(
            num_steps, limits.horizon_s, num_control_points=num_control_points, degree=degree
        )
        return Refiner(basis, limits, steps)

    def refine(
        self,
        state: FloatArray,
        fields: CostFields,
        *,
        x_curr: FloatArray,
        x_goal: FloatArray,
        w_style: FloatArray,
        spec: Refinement,
    ) -> Refined:
        """Finish sampled states [N, T, 3D] of one scene.

        x_curr: [3D]; x_goal: [2D]; w_style: [3]; all SI, in the map's frame. Neither smoothed nor
        projected, the states are returned as they were sampled.
        """
        cost = TrajectoryCost(self.basis, fields, self.limits, w_style, spec.safety_margin)
        control = self.basis.fit(state, x_curr, x_goal)
        if spec.project:
            control = self._project(cost, control)
        if spec.project or spec.smooth:
            states = self.basis.states(control)
        else:
            position, velocity, acceleration = np.split(state, 3, axis=-1)
            states = position, velocity, acceleration
        position, velocity, acceleration = (np.ascontiguousarray(s, np.float32) for s in states)
        verdict = verify((position, velocity, acceleration), fields.clearance, self.limits)
        scores = -cost.value(control)
        return Refined(position, velocity, acceleration, scores, verdict.clearance, verdict.safe)

    def _project(self, cost: TrajectoryCost, control: FloatArray) -> FloatArray:
        """Descend, again where not one anchor has come out safe, and bring the failures back."""
        field = cost.fields.clearance
        for rate in (DESCENT_RATE, *FURTHER_RATES):
            control = descend(cost, control, steps=self.steps, rate=rate)
            safe = verify(self.basis.states(control), field, self.limits).safe
            if safe.any():
                return bisect_to_safe(control, safe, self.basis, field, self.limits)
            cost = replace(cost, weights=cost.weights.stiffer(STIFFER))
        return control
