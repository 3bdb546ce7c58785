"""Embeddings of places and times, and bilinear lookup in channels-last maps."""

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

    In units of the window's half side; the product of two embeddings depends on the distance of
    their places, which attention needs (Mildenhall et al., 2020; Tancik et al., 2020).
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


def lookup(features: Tensor, points: Tensor) -> Tensor:
    """Features at points: [B, H, W, F], [B, P, 2] (x, y in [-1, 1] over the map) -> [B, P, F].

    The same numbers as `grid_sample(align_corners=False, padding_mode="border")`; four gathers of
    whole rows run several times faster in onnxruntime than its GridSample, which goes by channel.
    """
    return lookup_at(features, *points.unbind(-1))


def lookup_at(features: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """`lookup` at places given by component, [B, P] each.

    No axis of one or two is last until features are weighed: onnxruntime goes through such an
    axis number by number where it broadcasts.
    """
    batch, height, width, channels = features.shape
    x = (x * (width / 2) + (width - 1) / 2).clamp(0, width - 1)
    y = (y * (height / 2) + (height - 1) / 2).clamp(0, height - 1)
    column, row = x.floor().clamp(max=width - 2), y.floor().clamp(max=height - 2)
    right, up = x - column, y - row
    scene = torch.arange(batch, device=features.device)[:, None] * (height * width)
    corner = ((row * width + column).long() + scene).reshape(-1)
    table = features.reshape(batch * height * width, channels)

    def taken(offset: int, weight: Tensor) -> Tensor:
        rows = table.index_select(0, corner + offset).reshape(batch, -1, channels)
        return rows * weight[..., None]

    # Weights of the four corners: fewer passes over the features than nested mixtures, and
    # torch.lerp exports as twice as many nodes.
    both = right * up
    low = taken(0, 1 - right - up + both) + taken(1, right - both)
    return low + taken(width, up - both) + taken(width + 1, both)


def lookup_sum(features: Tensor, points: Tensor, weights: Tensor) -> Tensor:
    """Sums over P points of weighted features.

    features: [B, H, W, F]; points: [B, N, P, 2]; weights: [B, N, S, P], of each of S equal shares
        of the features, or [B, N, P] of all -> [B, N, F]

    Places outside the map read its edge. One gather of the 4 P corners and one
    product: in onnxruntime on a CPU about twice as fast as `lookup` and a sum, and many times
    as fast as its GridSample, which goes by channel, and a sum.
    """
    batch, height, width, channels = features.shape
    x = (points[..., 0] * (width / 2) + (width - 1) / 2).clamp(0, width - 1)
    y = (points[..., 1] * (height / 2) + (height - 1) / 2).clamp(0, height - 1)
    column, row = x.floor().clamp(max=width - 2), y.floor().clamp(max=height - 2)
    right, up = x - column, y - row
    scene = torch.arange(batch, device=features.device)[:, None, None] * (height * width)
    corner = (row * width + column).long() + scene
    corners = torch.stack([corner, corner + 1, corner + width, corner + width + 1], -1).flatten(-2)
    shares = torch.stack(
        [(1 - right) * (1 - up), right * (1 - up), (1 - right) * up, right * up], -1
    )
    if weights.ndim == points.ndim - 1:
        weights = weights[:, :, None]
    share = (shares[:, :, None] * weights[..., None]).flatten(-2)
    rows = features.reshape(batch * height * width, channels).index_select(0, corners.reshape(-1))
    rows = rows.reshape(*corners.shape, channels)
    if share.shape[2] == 1:
        return (share @ rows).squeeze(-2)
    parts = rows.unflatten(-1, (share.shape[2], -1)).transpose(-2, -3)
    return (share[..., None, :] @ parts).flatten(-3)
