"""Guidance of a flow by the trajectory's own cost, without training and without a network.

The flow of p(x_1) becomes one of p(x_1) exp(-scale J(x_1)) by the covariance-weighted gradient
(Feng et al., "On the Guidance of Flow Matching", ICML 2025), asked where an anchor is going:

    u' = u - scale (1 - t) / (t^2 + (1 - t)^2) Σ_0 ∇J(x̂_1),    x̂_1 = x_t + (1 - t) u

J is the `TrajectoryCost` of the spline that is fitted to x̂_1. The fit is linear, so the gradient
goes back through its transpose. Σ_0 = basis' basis is the prior's covariance, so a correction is
itself a smooth curve that leaves both ends where they are. The torch generator takes any
differentiable cost in this same form (`anchorflow_models.generation.steering`, with the sources).

J is stiff where an anchor crosses an obstacle, and a solver's step would overshoot it by metres. So
a step moves an anchor by at most REACH standard deviations of the prior, whatever the scale is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.spline.basis import Ends

REACH = 0.125  # standard deviations of the prior


@dataclass(frozen=True, eq=False)
class Guidance:
    """Guidance in one scene. Several threads may correct at once.

    ends: that anchors meet
    prior_basis: [R, T*(3D + 1)], the prior's rows in SI units
    scale: anchors are drawn as if those of cost J were exp(-scale J) times as likely
    """

    cost: TrajectoryCost
    ends: Ends
    prior_basis: FloatArray
    scale: float

    def correct(self, field: FloatArray, x_t: FloatArray, t: float, *, stride: float) -> None:
        """Make the field u [N, T, 3D + 1] at x_t and flow time t the guided one, in place.

        From t = 1 on there is nothing left to decide, and it stays as it is.

        stride: of the solver's step, in flow time
        """
        remaining = 1.0 - t
        if remaining <= 0.0:
            return
        change = np.multiply(field, remaining, dtype=np.float32)
        change += x_t  # x̂_1
        slope = self._slope(change) @ self.prior_basis.T
        slope *= self.scale * remaining / (t**2 + remaining**2)
        size = np.sqrt(np.einsum("nr,nr->n", slope, slope))
        slope *= np.minimum(1.0, REACH / np.maximum(stride * size, 1e-12))[:, None]
        np.matmul(slope, self.prior_basis, out=change.reshape(len(field), -1))
        field -= change

    def _slope(self, states: FloatArray) -> FloatArray:
        """∇J of states [N, T, 3D + 1]: [N, T*(3D + 1)]."""
        basis, limits = self.cost.basis, self.cost.limits
        duration = limits.durations(states)
        splines = basis.fit(states[..., :-1], self.ends, duration)
        _, gradient = self.cost.value_and_gradient(splines)
        fields = gradient.control[..., basis.free] @ basis.fit_matrix  # [D, N, 3T]
        count, steps = states.shape[:2]
        slope = np.zeros_like(states)
        slope[..., :-1] = (
            fields.reshape(-1, count, 3, steps).transpose(1, 3, 2, 0).reshape(count, steps, -1)
        )
        if limits.horizon_s is None:
            ending = basis.end_slopes(self.ends, duration)
            # The fit takes back on the free control points what the fixed ones explain.
            ending[..., basis.free] = -basis.fit_free(basis.own_time_states(ending))
            along = gradient.log_duration + np.einsum("dmk,dmk->m", gradient.control, ending)
            slope[..., -1] = along[:, None] / steps
        return slope.reshape(count, -1)
