"""Goals: the possible ends of trajectories, their scores, and the choice among them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from anchorflow_models.goalflow.raster import Extent, at_places

X_UNIT, Y_UNIT = 40.0, 20.0
"""m, scales of places for the networks."""
TAKEN = -1e9


class WayScores(NamedTuple):
    """Logits [B, P] of ways: that they end near where was driven, stay on the road, follow the
    route."""

    distance: Tensor
    drivable: Tensor
    route: Tensor


def in_units(poses: Tensor) -> Tensor:
    """Scale poses [..., 3] for the networks: [..., 4]."""
    x, y, heading = poses.unbind(-1)
    return torch.stack([x / X_UNIT, y / Y_UNIT, heading.cos(), heading.sin()], -1)


class WayScorer(nn.Module):
    """Scores delta = delta_dac · delta_dis of ways to goals, by the features at their poses."""

    def __init__(self, *, steps: int, features: int, context: int, width: int) -> None:
        super().__init__()
        self.of_way = nn.Linear(steps * (features + 4), width)
        self.of_scene = nn.Linear(context, width)
        self.rest = nn.Sequential(nn.SiLU(), nn.Linear(width, width), nn.SiLU())
        self.out = nn.Linear(width, 3)

    def forward(
        self, poses: Tensor, features: Tensor, context: Tensor, *, extent: Extent
    ) -> WayScores:
        """poses [B, P, T, 3]; features [B, h, w, F]; context [B, E]."""
        seen = at_places(features, poses[..., :2], extent)
        way = torch.cat([seen, in_units(poses)], -1).flatten(2)
        hidden = self.rest(self.of_way(way) + self.of_scene(context)[:, None])
        return WayScores(*self.out(hidden).unbind(-1))


def pick(goals: Tensor, scores: Tensor, *, count: int, spacing: float) -> Tensor:
    """Return indices [B, count] of the best goals that keep their spacing, the best first.

    goals: [K, 2] m; scores: [B, K] from 0 to 1. If too few are left, those near
    to the fewest picked goals follow.
    """
    near = (goals[:, None] - goals).square().sum(-1) < spacing**2
    number = torch.arange(goals.shape[0], device=goals.device)
    left, picked = scores, []
    for _ in range(count):
        best = left.argmax(-1)
        picked.append(best)
        # Below all that are near to fewer.
        left = torch.where(near[best], left - 2.0, left)
        left = torch.where(number == best[:, None], TAKEN, left)
    return torch.stack(picked, -1)
