"""Attention to the bird's-eye view at the places where a trajectory lies."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.lookup import lookup_sum
from anchorflow_models.transfuser import bev_places

FIRST_LOOK = 2.0
"""Logit of the point that a head begins by looking at; the others' are 0."""


class BevAttention(nn.Module):
    """Each query takes the values at its trajectory's points, by weights of its own choice.

    heads: shares of the values, each with weights of its own; several begin by looking at one point
        each, from the first to the last
    reach: m from the middle of the BEV to its edges; ahead: m by which it lies before the ego
    """

    def __init__(
        self, width: int, *, points: int, heads: int, reach: float, ahead: float = 0.0
    ) -> None:
        super().__init__()
        self.reach, self.ahead, self.heads = reach, ahead, heads
        self.weights = nn.Linear(width, heads * points)
        if heads > 1:
            own = torch.arange(heads) * points // heads
            with torch.no_grad():
                self.weights.bias.copy_(FIRST_LOOK * F.one_hot(own, points).flatten())
        self.out = nn.Linear(width, width)

    def forward(self, queries: Tensor, points: Tensor, values: Tensor) -> Tensor:
        """What to add to queries [B, N, W]; points: [B, N, T, 2] m; values: [B, H, H, W]"""
        weights = self.weights(queries).unflatten(-1, (self.heads, -1)).softmax(-1)
        places = bev_places(points, self.reach, ahead=self.ahead)
        return self.out(lookup_sum(values, places, weights))
