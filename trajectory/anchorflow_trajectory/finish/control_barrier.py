"""A control barrier on finished anchors: move those too close to obstacles as little as possible.

The barrier function of an anchor is a smooth lower bound of the clearance of its samples,

    h(c) = -1/κ log Σ_k exp(-κ (clearance(p_k) - margin)),

and where h < 0 its free control points c move by the closed form of a quadratic program with one
constraint, in the metric M in which smoothness is round (`whitening`):

    δ = M g max(0, -α h) / (g·M g + ε^2),    g = ∇h(c)

The program is that of `anchorflow_models.generation.steering`, which steers anchors during sampling
in torch (Ames et al., ECC 2019; SafeDiffuser; SafeFlow). This one acts at t = 1, on the spline, and
repeats because clearance is not linear. It keeps clearance only: `certificate` checks the limits,
and `bisection` moves the anchors that remain unsafe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.spline.basis import PLANE, SplineBasis, Splines, whitening

SHARPNESS = 40.0  # κ, 1/m: with five equal samples h is 0.04 m below their clearance
RATE = 1.0  # α: share of a shortfall that one correction closes, to first order
SLACK = 0.1  # ε, m: bounds the correction between near walls and at fixed ends
CORRECTIONS = 8
BETWEEN = 0.02  # m of clearance that a path may lose between two samples


@dataclass(frozen=True, eq=False)
class ControlBarrier:
    """The barrier of one scene; margin: m of clearance for every sample."""

    basis: SplineBasis
    clearance: GridField
    margin: float

    def corrected(self, splines: Splines) -> Splines:
        """Move the control points of splines with h < 0; ends and durations stay."""
        free, root = self.basis.free, whitening(self.basis)
        control = splines.control.copy()
        for _ in range(CORRECTIONS):
            h, gradient = self.value_and_gradient(control)
            direction = (gradient @ root) @ root.T
            variance = np.einsum("dmf,dmf->m", gradient, direction)
            share = RATE * np.maximum(-h, 0.0) / (variance + SLACK**2)
            control[PLANE, :, free] += share[:, None] * direction
        return Splines(control, splines.duration)

    def value_and_gradient(self, control: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return h [M] in m and its gradient [2, M, F] by the free control points."""
        rows = self.basis.position
        x, y = control[PLANE] @ rows.T
        clearance, along_x, along_y = self.clearance.sample_with_gradient(x, y)
        lack = SHARPNESS * (self.margin - clearance)
        most = lack.max(-1, keepdims=True)
        weight = np.exp(lack - most)
        total = weight.sum(-1, keepdims=True)
        h = -(most + np.log(total))[:, 0] / SHARPNESS
        slope = np.stack([along_x, along_y]) * (weight / total)
        return h, slope @ rows[:, self.basis.free]
