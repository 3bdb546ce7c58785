"""Attention to the bird's-eye view at the places where a trajectory lies."""

from __future__ import annotations

from torch import Tensor, nn

from anchorflow_models.layers.lookup import lookup_sum
from anchorflow_models.transfuser import bev_places


class BevAttention(nn.Module):
    """Each query takes the values at its trajectory's points, by weights of its own choice.

    reach: m from the middle of the BEV to its edges
    """

    def __init__(self, width: int, *, points: int, reach: float) -> None:
        super().__init__()
        self.reach = reach
        self.weights = nn.Linear(width, points)
        self.out = nn.Linear(width, width)

    def forward(self, queries: Tensor, points: Tensor, values: Tensor) -> Tensor:
        """What to add to queries [B, N, W]; points: [B, N, T, 2] m; values: [B, H, H, W]"""
        weights = self.weights(queries).softmax(-1)
        return self.out(lookup_sum(values, bev_places(points, self.reach), weights))
