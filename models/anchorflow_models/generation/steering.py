"""Guidance and a control barrier, which correct a flow's field while anchors are drawn.

**Guidance** follows any differentiable cost J, without training: the flow of p(x_1) becomes one of
p(x_1) exp(-scale J(x_1)) by the covariance-weighted gradient (Feng et al., "On the Guidance of Flow
Matching", ICML 2025):

    u' = u - scale Cov(x_1 | x_t) / (1 - t) ∇J(x̂_1),    x̂_1 = E[x_1 | x_t] = x_t + (1 - t) u

The cost is evaluated at x̂_1, the expected end of the flow; x_t is mostly noise while there is still
something to decide. The gradient does not pass through the network: the covariance is that of data
with the prior's covariance Σ_0, which the prior takes from the data (the same r_t^2 as Pokle et
al., "Training-free Linear Image Inverses via Flows", TMLR 2024):

    Cov(x_1 | x_t) = (1 - t)^2 / (t^2 + (1 - t)^2) Σ_0

It is exact for such Gaussian data and a linear cost, a first-order step otherwise.

**The barrier** is a smooth lower bound of the clearance that an anchor's steps have,

    h(x) = -1/κ log Σ_k exp(-κ (clearance(p_k) - margin)),

and the field is corrected, as little as possible, if dh/dt >= -α h would fail (Ames et al.,
"Control Barrier Functions: Theory and Applications", ECC 2019; for generative planners Xiao et al.,
"SafeDiffuser", 2023, and Dai et al., "SafeFlow", 2025). It is evaluated at x̂_1 too: keeping noise
off obstacles distorts and traps anchors (Yang et al., "SafeFlowMatcher", 2025). A straight flow
leaves x̂_1 where it is, so a correction δ is all that moves it, and one constraint an anchor leaves
a quadratic program with a closed form,

    dx̂_1/dt = δ = Σ_0 g max(0, -α h) / (g·Σ_0 g + ε^2),    g = ∇h(x̂_1),

in the metric of the prior, so that the corrected anchor is still a smooth one between both ends.
ε is the program's slack: no correction explodes if the ends or two near walls leave no way out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_models.checks import check
from anchorflow_models.layers.clearance_map import ClearanceMap
from anchorflow_trajectory.finish.control_barrier import SHARPNESS, SLACK

Cost = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Guidance:
    """Guidance by a cost.

    cost: states [B, N, T, 3D + 1] -> [B, N], differentiable; a state is p, p', p'' by the
        trajectory's own time, in m and the map's frame, and the log duration
    scale: 0 or more; anchors are drawn as if those of cost J were exp(-scale J) times as likely,
        so a cost in m takes a scale in 1/m
    """

    cost: Cost
    scale: float

    def __post_init__(self) -> None:
        check("scale", 0 <= self.scale < float("inf"), "a number of 0 or more", self.scale)

    def guided(self, field: Tensor, x_t: Tensor, t: float, prior_basis: Tensor) -> Tensor:
        """Return u' [B, N, T, S] of the field u at x_t."""
        remaining = 1.0 - t
        if remaining <= 0.0:
            return field
        x_1 = (x_t + remaining * field).detach().requires_grad_()
        with torch.enable_grad():
            cost = self.cost(x_1)
            check("cost", cost.shape == x_1.shape[:2], "[B, N] of the states", list(cost.shape))
            (gradient,) = torch.autograd.grad(cost.sum(), x_1)
        weight = self.scale * remaining / (t**2 + remaining**2)
        return field - weight * along_prior(gradient, prior_basis)


@dataclass(frozen=True, eq=False)
class Barrier:
    """The control barrier of B scenes.

    margin: [B] m of clearance to keep
    rate: α; a unit of flow time leaves exp(-α) of a shortfall
    """

    clearance: ClearanceMap
    margin: Tensor
    rate: float

    @staticmethod
    def of(clearance: ClearanceMap, *, margin: float, rate: float, ends: Tensor) -> Barrier:
        """Return a barrier whose margin no end [B, 2, D] of an anchor violates."""
        return Barrier(clearance, clearance(ends).amin(-1).clamp(max=margin), rate)

    def value_and_gradient(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return h [B, N] in m and its gradient [B, N, T, S] at states x [B, N, T, S]."""
        x = x.detach().requires_grad_()
        with torch.enable_grad():
            lack = self.margin[:, None, None] - self.clearance(x)
            h = -torch.logsumexp(SHARPNESS * lack, -1) / SHARPNESS
            (gradient,) = torch.autograd.grad(h.sum(), x)
        return h.detach(), gradient

    def kept(
        self, field: Tensor, x_t: Tensor, t: float, prior_basis: Tensor, *, stride: float | None
    ) -> Tensor:
        """Return the field u + δ [B, N, T, S] of the field u at x_t.

        stride: of the solver, in flow time. A correction would overshoot over a stride longer than
            1/α, so α is at most 1/stride (the discrete-time condition of Agrawal and Sreenath, RSS
            2017). None: a solver that controls its error
        """
        rate = self.rate if stride is None else min(self.rate, 1.0 / stride)
        h, gradient = self.value_and_gradient(x_t + (1.0 - t) * field)
        direction = along_prior(gradient, prior_basis)
        variance = (gradient * direction).sum((-2, -1))
        share = rate * (-h).clamp(min=0) / (variance + SLACK**2)
        return field + share[..., None, None] * direction


@dataclass(frozen=True, eq=False)
class Steering:
    """The corrections of a field: guidance first, then the barrier, which has the last word.

    prior_basis: [B, R, T S]
    """

    prior_basis: Tensor
    guidance: Guidance | None
    barrier: Barrier | None

    def steered(self, field: Tensor, x_t: Tensor, t: float, *, stride: float | None) -> Tensor:
        """Return the corrected field [B, N, T, S] at x_t; stride: None for a solver of its own."""
        if self.guidance is not None:
            field = self.guidance.guided(field, x_t, t, self.prior_basis)
        if self.barrier is not None:
            field = self.barrier.kept(field, x_t, t, self.prior_basis, stride=stride)
        return field


def along_prior(gradient: Tensor, prior_basis: Tensor) -> Tensor:
    """Return Σ_0 g, the steepest change of a state that the prior's own smooth curves can make.

    gradient: g [B, N, T, S]; prior_basis: B_0 [B, R, T S], so that Σ_0 = B_0' B_0

    Whatever g is, the result belongs to a trajectory whose velocity and acceleration are its
    position's own, and it leaves both ends where they are.
    """
    noise = gradient.flatten(2) @ prior_basis.transpose(1, 2)
    return (noise @ prior_basis).reshape(gradient.shape)
