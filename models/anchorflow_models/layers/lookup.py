"""Bilinear lookup in a channels-last map."""

from __future__ import annotations

import torch
from torch import Tensor


def lookup(features: Tensor, points: Tensor) -> Tensor:
    """Features at points: [B, H, W, F], [B, P, 2] (x, y in [-1, 1] over the map) -> [B, P, F].

    The same numbers as `grid_sample(align_corners=False, padding_mode="border")`; four gathers of
    whole rows run several times faster in onnxruntime than its GridSample, which goes by channel.
    """
    batch, height, width, channels = features.shape
    x = ((points[..., 0] + 1) * (width / 2) - 0.5).clamp(0, width - 1)
    y = ((points[..., 1] + 1) * (height / 2) - 0.5).clamp(0, height - 1)
    column, row = x.floor().clamp(max=width - 2), y.floor().clamp(max=height - 2)
    right, up = (x - column)[..., None], (y - row)[..., None]
    scene = torch.arange(batch, device=features.device)[:, None] * (height * width)
    corner = ((row * width + column).long() + scene).reshape(-1)
    table = features.reshape(batch * height * width, channels)

    def take(offset: int) -> Tensor:
        return table.index_select(0, corner + offset).reshape(batch, -1, channels)

    low = torch.lerp(take(0), take(1), right)
    high = torch.lerp(take(width), take(width + 1), right)
    return torch.lerp(low, high, up)
