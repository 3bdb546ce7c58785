"""Who will be where trajectories lead, by maps of where others will be."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.blocks import zero_linear
from anchorflow_models.layers.places import lookup
from anchorflow_models.transfuser.config import TransfuserConfig
from anchorflow_models.transfuser.footprint import Places, bev_places, placed

FORETOLD_S = 0.25
"""s, from one map to the next; poses lie a multiple of it apart."""
LOOKAHEAD = (0, 1, 2, 3, 4)
"""Steps of FORETOLD_S after each pose at which is asked who is there."""
LEAST_SHARE = 1e-3


def foretold_times(steps: int, step_s: float) -> tuple[float, ...]:
    """Return the times in s of the maps that `steps` poses need, the first step_s from now."""
    last = round(steps * step_s / FORETOLD_S) + LOOKAHEAD[-1]
    return tuple(FORETOLD_S * (index + 1) for index in range(last))


class Encounters(nn.Module):
    """Adds to trajectories who will be where they lead: in each pose, and within a second of it at
    its speed and heading, as the PDM score's collisions and time to collision ask; at first
    nothing, as its last layer begins with zeros.

    Args:
        width: of what is added; hidden: of what is made of each pose
        steps, step_s: poses of a trajectory, s between two and until the first
        places: m ahead and to the left of a pose, where is asked
        backbone: whose BEV the maps show
    """

    places: Tensor
    maps: Tensor
    ahead: Tensor

    def __init__(
        self,
        width: int,
        *,
        hidden: int,
        steps: int,
        step_s: float,
        places: Places,
        backbone: TransfuserConfig,
    ) -> None:
        super().__init__()
        self.steps, self.step_s = steps, step_s
        self.reach, self.beyond = backbone.lidar_range, backbone.far_range
        self.register_buffer("places", torch.tensor(places), persistent=False)
        reached = [round((pose + 1) * step_s / FORETOLD_S) - 1 for pose in range(steps)]
        at = [first + step for first in reached for step in LOOKAHEAD]
        self.register_buffer("maps", torch.tensor(at), persistent=False)
        self.register_buffer("ahead", FORETOLD_S * torch.tensor(LOOKAHEAD), persistent=False)
        self.pose = nn.Linear(len(places) * len(LOOKAHEAD), hidden)
        self.times = nn.Parameter(0.02 * torch.randn(steps, hidden))
        self.whole = zero_linear(steps * hidden + len(LOOKAHEAD), width)

    def forward(self, x: Tensor, poses: Tensor, foretold: Tensor) -> Tensor:
        """x: [B, M, W]; poses: [B, M, T, 3] m, m, rad; foretold: [B, L, H', H] the share of each
        cell that others take at the times `foretold_times` names"""
        share = (foretold + LEAST_SHARE).log() / 3 + 1  # shares of thousandths matter too
        points = placed(self._moved_on(poses), self.places)
        points = bev_places(points, self.reach, beyond=self.beyond)
        # [B, M, T, L, P, 2]: each in the map of its time.
        points = points.permute(0, 2, 3, 1, 4, 5).flatten(1, 2).flatten(0, 1)
        values = share[:, self.maps].flatten(0, 1)[..., None]
        found = lookup(values, points.flatten(1, 2)).unflatten(1, (-1, len(self.places)))
        found = found[..., 0].unflatten(0, (-1, self.steps, len(LOOKAHEAD)))
        found = found.permute(0, 3, 1, 2, 4)
        pose = F.relu(self.pose(found.flatten(3)) + self.times).flatten(2)
        return x + self.whole(torch.cat([pose, found.amax((2, 4))], -1))

    def _moved_on(self, poses: Tensor) -> Tensor:
        """[B, M, T, L, 3]: the poses, and where their speed and heading lead from them."""
        way = poses[..., :2]
        way = way - torch.cat([torch.zeros_like(way[:, :, :1]), way[:, :, :-1]], 2)
        on = way.norm(dim=-1, keepdim=True) / self.step_s * self.ahead
        heading = poses[..., 2:]
        moved = torch.stack([on * heading.cos(), on * heading.sin(), torch.zeros_like(on)], -1)
        return poses[..., None, :] + moved
