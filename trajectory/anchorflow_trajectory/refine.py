"""Finish anchors: fit splines that meet both ends, push them clear, and measure what came out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.bisection import bisect_to_safe
from anchorflow_trajectory.clearance import GridField
from anchorflow_trajectory.control_barrier import BETWEEN, ControlBarrier
from anchorflow_trajectory.cost import MotionLimits, TrajectoryCost
from anchorflow_trajectory.cost_fields import CostFields
from anchorflow_trajectory.descent import descend
from anchorflow_trajectory.spline import SplineBasis, spline_basis
from anchorflow_trajectory.verify import required_clearance, verify

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

DESCENT_RATE = 0.3  # m, a first step on the control points
# Where nothing is safe yet, further descents: a hard scene costs more time than an easy one.
FURTHER_RATES = (0.15, 0.15, 0.15)
STIFFER = 4.0  # by how much obstacles and limits then weigh more, from one to the next
AIM_BEYOND = 0.1  # m beyond a certified margin that the descent aims at, so that it is kept


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

    @property
    def barrier(self) -> bool:
        """Correct what is not clear enough by a control barrier."""
        ...

    @property
    def certified_margin(self) -> float:
        """m of clearance beyond the robot's radius that every anchor called safe keeps."""
        ...


@dataclass(frozen=True)
class Refined:
    """Anchors of one scene.

    positions, velocities, accelerations: [N, T, D] in m, m/s, m/s^2
    scores: [N], minus the expert's cost for the requested style; higher is better
    clearance: [N] m beyond robot_radius, smallest along the path
    safe: [N], clear of every obstacle and of the map's edge by the certified margin, and within
        the limits
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

    steps: descents on the control points where a request asks to project; what is not safe then
        is corrected by the barrier, if one is asked for, and brought back by bisection
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
        projected nor corrected, the states are returned as they were sampled.
        """
        cost = self.cost(fields, w_style=w_style, spec=spec)
        control = self.basis.fit(state, x_curr, x_goal)
        field, ends = fields.clearance, (x_curr, x_goal)
        certified = spec.certified_margin if self._attainable(spec, field, ends) else 0.0
        barrier = self._barrier(field, certified) if spec.barrier else None
        if spec.project:
            control = self._project(cost, control, certified, barrier)
        elif barrier is not None:
            control, _ = self._corrected(control, field, certified, barrier)
        if spec.project or spec.smooth or spec.barrier:
            states = self.basis.states(control)
        else:
            position, velocity, acceleration = np.split(state, 3, axis=-1)
            states = position, velocity, acceleration
        position, velocity, acceleration = (np.ascontiguousarray(s, np.float32) for s in states)
        states = (position, velocity, acceleration)
        verdict = verify(states, field, self.limits, certified_margin=spec.certified_margin)
        scores = -cost.value(control)
        return Refined(position, velocity, acceleration, scores, verdict.clearance, verdict.safe)

    def cost(self, fields: CostFields, *, w_style: FloatArray, spec: Refinement) -> TrajectoryCost:
        """What the projection descends, the scores tell and guidance follows; w_style: [3]."""
        margin = spec.safety_margin
        if spec.certified_margin > 0.0:
            margin = max(margin, spec.certified_margin + AIM_BEYOND)
        return TrajectoryCost(self.basis, fields, self.limits, w_style, margin)

    def _project(
        self,
        cost: TrajectoryCost,
        control: FloatArray,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> FloatArray:
        """Descend, again where not one anchor has come out safe, and bring the failures back."""
        field = cost.fields.clearance
        for rate in (DESCENT_RATE, *FURTHER_RATES):
            control = descend(cost, control, steps=self.steps, rate=rate)
            control, safe = self._corrected(control, field, certified, barrier)
            if safe.any():
                return bisect_to_safe(
                    control, safe, self.basis, field, self.limits, certified_margin=certified
                )
            cost = replace(cost, weights=cost.weights.stiffer(STIFFER))
        return control

    def _corrected(
        self,
        control: FloatArray,
        field: GridField,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> tuple[FloatArray, BoolArray]:
        """Those corrected that the barrier, if there is one, makes safe; and which then are."""
        safe = self._safe(control, field, certified)
        if barrier is None or safe.all():
            return control, safe
        corrected = barrier.corrected(control[:, ~safe])
        gained = self._safe(corrected, field, certified)
        control, failed = control.copy(), np.flatnonzero(~safe)
        control[:, failed[gained]] = corrected[:, gained]
        safe[failed[gained]] = True
        return control, safe

    def _safe(self, control: FloatArray, field: GridField, certified: float) -> BoolArray:
        states = self.basis.states(control)
        return verify(states, field, self.limits, certified_margin=certified).safe

    def _barrier(self, field: GridField, certified: float) -> ControlBarrier:
        return ControlBarrier(self.basis, field, required_clearance(field, certified) + BETWEEN)

    @staticmethod
    def _attainable(
        spec: Refinement, field: GridField, ends: tuple[FloatArray, FloatArray]
    ) -> bool:
        """Whether both ends keep the certified margin themselves.

        Where one does not, no anchor is safe, and the projection does what it does without one.
        """
        x, y = np.stack([end[:2] for end in ends], axis=1)
        return bool((field.sample(x, y) >= required_clearance(field, spec.certified_margin)).all())
