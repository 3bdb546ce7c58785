"""Conditional flow matching (Lipman et al., 2023): the path between noise and data, and the loss.

t = 0 is noise, t = 1 is data; many papers run the other way.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


def interpolate(x_0: Tensor, x_1: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """The point x_t on the straight path and the field's target there, x_1 - x_0.

    x_0, x_1: [B, N, T, S]; t: [B, N] in [0, 1].
    """
    t = t[..., None, None]
    return t * x_1 + (1 - t) * x_0, x_1 - x_0


@dataclass(frozen=True)
class LossWeights:
    """Weights of the velocity, acceleration and jerk terms against the position's 1."""

    lambda_vel: float = 0.5
    lambda_acc: float = 0.25
    lambda_jerk: float = 0.05


def flow_matching_loss(
    predicted: Tensor, target: Tensor, weights: LossWeights
) -> tuple[Tensor, dict[str, Tensor]]:
    """Weighted mean squared error of the three fields, and each term by itself.

    predicted, target: [B, N, T, 3D], normalised so that each field has unit spread. The jerk term
    compares differences of the acceleration field along the trajectory.
    """
    error = predicted - target
    position, velocity, acceleration = error.chunk(3, -1)
    terms = {
        "position": position.square().mean(),
        "velocity": velocity.square().mean(),
        "acceleration": acceleration.square().mean(),
        "jerk": torch.diff(acceleration, dim=-2).square().mean(),
    }
    gains = (1.0, weights.lambda_vel, weights.lambda_acc, weights.lambda_jerk)
    total = sum(g * term for g, term in zip(gains, terms.values(), strict=True))
    return torch.as_tensor(total), terms
