"""Embeddings of position along a trajectory and of flow time."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

PLACE_OCTAVES = 4


def sinusoidal_positions(count: int, width: int) -> Tensor:
    """[count, width] sines and cosines at geometric wavelengths (Vaswani et al., 2017)."""
    rates = torch.exp(-math.log(10_000.0) * torch.arange(0, width, 2) / width)
    angles = torch.arange(count)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], -1).flatten(1)


def sinusoidal(values: Tensor, features: int, *, longest: float, shortest: float) -> Tensor:
    """[...] -> [..., features]: sines and cosines at wavelengths from longest to shortest.

    In the unit of the values; the wavelengths are a geometric row (Vaswani et al., 2017).
    """
    exponents = torch.linspace(0, 1, features // 2, device=values.device)
    rates = 2 * math.pi / longest * (longest / shortest) ** exponents
    angles = values[..., None] * rates
    return torch.cat([angles.sin(), angles.cos()], -1)


def fourier_places(points: Tensor, *, octaves: int = PLACE_OCTAVES) -> Tensor:
    """Places [..., 2] -> [..., 4 * octaves]: sines and cosines at wavelengths 4, 2, 1, 1/2, ...

    In units of the window's half side; the products of two embeddings tell how far apart their
    places are, which is what attention needs (Mildenhall et al., 2020; Tancik et al., 2020).
    """
    rates = 0.5 * math.pi * 2.0 ** torch.arange(octaves, device=points.device)
    angles = (points[..., None] * rates).flatten(-2)
    return torch.cat([angles.sin(), angles.cos()], -1)


class GaussianFourierTime(nn.Module):
    """Flow time t in [0, 1] -> [..., width]: random Fourier features (Tancik et al., 2020)."""

    rates: Tensor

    def __init__(self, width: int, *, features: int = 64, scale: float = 2.0) -> None:
        super().__init__()
        self.register_buffer("rates", torch.randn(features) * scale)
        self.mlp = nn.Sequential(nn.Linear(2 * features, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, t: Tensor) -> Tensor:
        angles = 2 * math.pi * t[..., None] * self.rates
        return self.mlp(torch.cat([angles.sin(), angles.cos()], -1))
