"""Conditional flow matching (Lipman et al., 2023): the path between noise and data, and the loss.

t = 0 is noise, t = 1 is data; many papers run the other way.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_models.checks import check


def interpolate(x_0: Tensor, x_1: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """Return x_t on the straight path and the field's target there, x_1 - x_0.

    x_0, x_1: [B, N, T, S]; t: [B, N] in [0, 1].
    """
    t = t[..., None, None]
    return t * x_1 + (1 - t) * x_0, x_1 - x_0


@dataclass(frozen=True)
class LossWeights:
    """Weights of the loss's terms.

    lambda_vel: of u, the velocity field, which moves positions
    lambda_acc: of v, the acceleration field, which moves p'
    lambda_jerk: of w, the jerk field, which moves p''
    lambda_roughness: of differences of w's error along the trajectory
    lambda_duration: of the field that moves log durations

    Raises:
        ValueError: a weight is below 0.
    """

    lambda_vel: float = 1.0
    lambda_acc: float = 0.5
    lambda_jerk: float = 0.25
    lambda_roughness: float = 0.05
    lambda_duration: float = 0.5

    def __post_init__(self) -> None:
        for name, weight in vars(self).items():
            check(name, weight >= 0, "at least 0", weight)


def flow_matching_loss(
    predicted: Tensor,
    target: Tensor,
    weights: LossWeights,
    *,
    sample_weights: Tensor | None = None,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Return the weighted mean squared error of the fields, and each term unweighted.

    predicted, target: [B, N, T, 3D + 1], u, v, w and that of log duration after one another (or the
        states that they lead to), normalised so that each has unit spread
    sample_weights: [B, N], the weight of each sample in every mean; about 1 on average
    """
    error = predicted - target
    velocity, acceleration, jerk = error[..., :-1].chunk(3, -1)
    errors = {
        "velocity_field": velocity,
        "acceleration_field": acceleration,
        "jerk_field": jerk,
        "roughness": torch.diff(jerk, dim=-2),
        "duration_field": error[..., -1:],
    }
    terms = {name: _mean_square(error, sample_weights) for name, error in errors.items()}
    gains = (
        weights.lambda_vel,
        weights.lambda_acc,
        weights.lambda_jerk,
        weights.lambda_roughness,
        weights.lambda_duration,
    )
    total = sum(g * term for g, term in zip(gains, terms.values(), strict=True))
    return torch.as_tensor(total), terms


def _mean_square(error: Tensor, sample_weights: Tensor | None) -> Tensor:
    squares = error.square()
    if sample_weights is not None:
        squares = squares * sample_weights[..., None, None]
    return squares.mean()
