"""Guidance of a flow by the trajectory's own cost, without training and without a network.

The flow of p(x_1) becomes one of p(x_1) exp(-scale J(x_1)) by the covariance-weighted gradient
(Feng et al., "On the Guidance of Flow Matching", ICML 2025), asked where an anchor is going:

    u' = u - scale (1 - t) / (t^2 + (1 - t)^2) Σ_0 ∇J(x̂_1),    x̂_1 = x_t + (1 - t) u

J is the `TrajectoryCost` of the spline that is fitted to x̂_1. The fit is linear, so the gradient
goes back through its transpose. Σ_0 = basis' basis is the prior's covariance, so a correction is
itself a smooth curve that leaves both ends where they are. The torch generator takes any
differentiable cost in this same form (`anchorflow_models.generation.guidance`, with the sources).

J is stiff where an anchor crosses an obstacle, and a solver's step would overshoot it by metres. So
a step moves an anchor by at most REACH standard deviations of the prior, whatever the scale is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost import TrajectoryCost
from anchorflow_trajectory.spline import SplineBasis

FloatArray = NDArray[np.floating]

REACH = 0.125  # standard deviations of the prior


@dataclass(frozen=True, eq=False)
class Guidance:
    """Guidance in one scene; build it with `of`. Several threads may correct at once.

    scale: anchors are drawn as if those of cost J were exp(-scale J) times as likely
    ends: [D, K], control points of the fit to a state of zeros
    fit: [T*3D, D*F], free control points from flattened states, beside those of `ends`
    prior_basis: [R, T*3D], the prior's rows in SI units
    to_prior: [D*F, R], the gradient in the prior's coordinates from that on free control points
    """

    cost: TrajectoryCost
    scale: float
    ends: FloatArray
    fit: FloatArray
    prior_basis: FloatArray
    to_prior: FloatArray

    @staticmethod
    def of(
        cost: TrajectoryCost,
        *,
        x_curr: FloatArray,
        x_goal: FloatArray,
        prior_basis: FloatArray,
        scale: float,
    ) -> Guidance:
        """x_curr: [3D]; x_goal: [2D]; prior_basis: [R, T*3D]."""
        dim = len(x_goal) // 2
        zeros = np.zeros((1, cost.basis.num_samples, 3 * dim), np.float32)
        ends = cost.basis.fit(zeros, x_curr, x_goal)[:, 0]
        fit = _flat_fit(cost.basis, dim)
        return Guidance(cost, scale, ends, fit, prior_basis, fit.T @ prior_basis.T)

    def correct(self, field: FloatArray, x_t: FloatArray, t: float, *, stride: float) -> None:
        """Make the field u [N, T, 3D] at x_t [N, T, 3D] and flow time t the guided one, in place.

        From t = 1 on there is nothing left to decide, and it stays as it is.

        stride: of the solver's step, in flow time
        """
        remaining = 1.0 - t
        if remaining <= 0.0:
            return
        change = np.multiply(field, remaining, dtype=np.float32)
        change += x_t  # x̂_1
        flat = change.reshape(len(field), -1)
        slope = self._slope(flat)
        slope *= self.scale * remaining / (t**2 + remaining**2)
        size = np.sqrt(np.einsum("nr,nr->n", slope, slope))
        slope *= np.minimum(1.0, REACH / np.maximum(stride * size, 1e-12))[:, None]
        np.matmul(slope, self.prior_basis, out=flat)
        field -= change

    def _slope(self, states: FloatArray) -> FloatArray:
        """∇J of flattened states [N, T*3D] in the prior's coordinates: [N, R]."""
        count, free = len(states), self.cost.basis.free
        control = np.repeat(self.ends[:, None], count, axis=1)
        moved = (states @ self.fit).reshape(count, len(control), -1)
        control[..., free] += moved.transpose(1, 0, 2)
        _, gradient = self.cost.value_and_gradient(control)
        return gradient[..., free].transpose(1, 0, 2).reshape(count, -1) @ self.to_prior


def _flat_fit(basis: SplineBasis, dim: int) -> FloatArray:
    """[T*3D, D*F]: the linear part of `basis.fit`, for states flattened as they are."""
    per_field = basis.fit_matrix.reshape(-1, 3, basis.num_samples)
    flat = np.einsum("kft,de->tfdek", per_field, np.eye(dim, dtype=np.float32))
    return flat.reshape(3 * dim * basis.num_samples, -1)
