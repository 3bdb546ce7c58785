"""Guidance by any differentiable cost, without training.

The flow of p(x_1) becomes one of p(x_1) exp(-scale J(x_1)) by the covariance-weighted gradient
(Feng et al., "On the Guidance of Flow Matching", ICML 2025):

    u' = u - scale Cov(x_1 | x_t) / (1 - t) ∇J(x̂_1),    x̂_1 = E[x_1 | x_t] = x_t + (1 - t) u

The cost is asked about x̂_1, where the anchor is going, and not about x_t, which is mostly noise
while there is still something to decide. The gradient does not pass through the network: the
covariance is that of data with the prior's covariance Σ_0, which the prior takes from the data
(the same r_t^2 as Pokle et al., "Training-free Linear Image Inverses via Flows", TMLR 2024):

    Cov(x_1 | x_t) = (1 - t)^2 / (t^2 + (1 - t)^2) Σ_0

It is exact for such Gaussian data and a linear cost, a first-order step otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_models.generation.checks import check
from anchorflow_models.generation.covariance import along_prior

Cost = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Guidance:
    """cost: states [B, N, T, 3D + 1] -> [B, N], differentiable; p, p', p'' by the trajectory's own
        time, in m and the map's frame, and log duration
    scale: 0 or more; anchors are drawn as if those of cost J were exp(-scale J) times as likely,
        so a cost in m wants a scale in 1/m
    """

    cost: Cost
    scale: float

    def __post_init__(self) -> None:
        check("scale", 0 <= self.scale < float("inf"), "a number of 0 or more", self.scale)

    def guided(self, field: Tensor, x_t: Tensor, t: float, prior_basis: Tensor) -> Tensor:
        """u' [B, N, T, S] of the field u at x_t."""
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
