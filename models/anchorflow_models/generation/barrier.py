"""A control barrier within the flow: anchors are steered clear while they are drawn.

The barrier function of an anchor is a smooth lower bound of the room that its steps have,

    h(x) = -1/κ log Σ_k exp(-κ (clearance(p_k) - margin)),

and the field is corrected, as little as it can be, where dh/dt >= -α h would fail (Ames et al.,
"Control Barrier Functions: Theory and Applications", ECC 2019; for generative planners Xiao et al.,
"SafeDiffuser", 2023, and Dai et al., "SafeFlow", 2025).

It is asked about x̂_1 = x_t + (1 - t) u, where the anchor is going: x_t itself is noise for most of
the way, and to keep noise off obstacles distorts and traps anchors (Yang et al., "SafeFlowMatcher",
2025, who correct predictions too). A straight flow leaves x̂_1 where it is, so a correction δ is all
that moves it, and one constraint an anchor leaves a quadratic program with a closed form,

    dx̂_1/dt = δ = Σ_0 g max(0, -α h) / (g·Σ_0 g + ε^2),    g = ∇h(x̂_1),

in the metric of the prior, so that the corrected anchor is still a smooth one between both ends.
ε is the program's slack: no correction explodes where the ends or two near walls leave no way out.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_models.generation.clearance_map import ClearanceMap
from anchorflow_models.generation.covariance import along_prior
from anchorflow_trajectory.finish.control_barrier import SHARPNESS, SLACK


@dataclass(frozen=True, eq=False)
class Barrier:
    """The barrier of B scenes.

    margin: [B] m of clearance to keep
    rate: α, of which a unit of flow time leaves exp(-α) of a shortfall
    """

    clearance: ClearanceMap
    margin: Tensor
    rate: float

    @staticmethod
    def of(clearance: ClearanceMap, *, margin: float, rate: float, ends: Tensor) -> Barrier:
        """ends: [B, 2, D]; one that is nearer to an obstacle than the margin lowers it."""
        return Barrier(clearance, clearance(ends).amin(-1).clamp(max=margin), rate)

    def value_and_gradient(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """h [B, N] in m and its gradient [B, N, T, S] at states x [B, N, T, S]."""
        x = x.detach().requires_grad_()
        with torch.enable_grad():
            lack = self.margin[:, None, None] - self.clearance(x)
            h = -torch.logsumexp(SHARPNESS * lack, -1) / SHARPNESS
            (gradient,) = torch.autograd.grad(h.sum(), x)
        return h.detach(), gradient

    def kept(
        self, field: Tensor, x_t: Tensor, t: float, prior_basis: Tensor, *, stride: float | None
    ) -> Tensor:
        """The field u + δ [B, N, T, S] of the field u at x_t.

        stride: the solver's, in flow time; over a longer one than 1/α a correction would
            overshoot, so α is at most 1/stride (the discrete-time condition of Agrawal and
            Sreenath, RSS 2017). None: a solver that controls its error
        """
        rate = self.rate if stride is None else min(self.rate, 1.0 / stride)
        h, gradient = self.value_and_gradient(x_t + (1.0 - t) * field)
        direction = along_prior(gradient, prior_basis)
        variance = (gradient * direction).sum((-2, -1))
        share = rate * (-h).clamp(min=0) / (variance + SLACK**2)
        return field + share[..., None, None] * direction
