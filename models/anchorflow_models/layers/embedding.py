"""Embeddings of position along a trajectory and of flow time."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn


def sinusoidal_positions(count: int, width: int) -> Tensor:
    """[count, width] sines and cosines at geometric wavelengths (Vaswani et al., 2017)."""
    rates = torch.exp(-math.log(10_000.0) * torch.arange(0, width, 2) / width)
    angles = torch.arange(count)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], -1).flatten(1)


class GaussianFourierTime(nn.Module):
    """Flow time t in [0, 1] -> [..., width]: random Fourier features (Tancik et al., 2020), an MLP."""

    rates: Tensor

    def __init__(self, width: int, *, features: int = 64, scale: float = 2.0) -> None:
        super().__init__()
        self.register_buffer("rates", torch.randn(features) * scale)
        self.mlp = nn.Sequential(nn.Linear(2 * features, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, t: Tensor) -> Tensor:
        angles = 2 * math.pi * t[..., None] * self.rates
        return self.mlp(torch.cat([angles.sin(), angles.cos()], -1))
