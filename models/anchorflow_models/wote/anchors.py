"""Anchors before any data are known, and where a place lies on the BEV grid."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

FASTEST = 15.0  # m/s
SHARPEST = 0.5 * math.pi  # rad in all
GOLDEN = (math.sqrt(5) - 1) / 2


def arcs(count: int, *, steps: int, dt: float) -> Tensor:
    """[count, steps, 3] poses on arcs at constant speed, spread evenly over speed and turn."""
    k = torch.arange(count)
    speed = FASTEST * (k + 0.5) / count
    turn = SHARPEST * (2 * (GOLDEN * k % 1) - 1)
    times = dt * torch.arange(1, steps + 1)
    way, heading = speed[:, None] * times, turn[:, None] * times / times[-1]
    # Of an arc that starts along x: the chord is sinc(heading / 2) of the way, at half the heading.
    chord = way * torch.sinc(heading / (2 * math.pi))
    return torch.stack([chord * (heading / 2).cos(), chord * (heading / 2).sin(), heading], -1)


def cells(places: Tensor, *, size: int, reach: float, ahead: float = 0.0) -> Tensor:
    """Which cell of a BEV a place lies in: [..., 2] m -> one-hot [..., size²].

    The grid covers ±reach about a place that lies `ahead` of the ego; row 0 lies farthest ahead,
    column 0 farthest left. A place beyond the edge counts to the cell at the edge.
    """
    middle = torch.tensor([ahead, 0.0]).to(places)
    index = ((reach + middle - places) / (2 * reach) * size).floor().clamp(0, size - 1).long()
    return F.one_hot(index[..., 0] * size + index[..., 1], size * size).to(places.dtype)
