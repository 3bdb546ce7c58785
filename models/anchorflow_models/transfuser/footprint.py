"""Values of a bird's-eye view where a trajectory's car would stand."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.places import lookup
from anchorflow_models.lqr_rollout import Start, driven


class BevValues(nn.Module):
    """What can be looked up in a BEV: a convolution, channels last."""

    def __init__(self, channels: int, width: int, *, kernel: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, width, kernel, padding=kernel // 2)

    def forward(self, bev: Tensor) -> Tensor:
        """[B, C, H, H] -> [B, H, H, W]"""
        return F.relu(self.conv(bev)).permute(0, 2, 3, 1)


def bev_places(points: Tensor, reach: float, *, beyond: float = 0.0, ahead: float = 0.0) -> Tensor:
    """Points [..., 2] m, x forward and y left, as column and row from -1 to 1 of a BEV.

    Its first row has the greatest x, its first column the greatest y.

    reach: m from the middle of the BEV to its edges; beyond: m by which it reaches farther ahead;
        ahead: m from the ego forward to its middle
    """
    x, y = points.unbind(-1)
    half = beyond / 2
    return torch.stack([-y / reach, (ahead + half - x) / (reach + half)], -1)


Places = tuple[tuple[float, float], ...]

CAR_WHEELBASE = 3.1
"""m, of nuPlan's car."""


class Footprint(nn.Module):
    """The BEV's values at some places of the car in each pose of a trajectory, as one feature.

    Args:
        channels: of the BEV's values
        width: of the feature
        steps: poses of a trajectory
        places: m ahead and to the left of a pose
        reach: m from the middle of the BEV to its edges
        ahead: m from the ego forward to its middle
    """

    places: Tensor

    def __init__(
        self,
        channels: int,
        width: int,
        *,
        steps: int,
        places: Places,
        reach: float,
        ahead: float = 0.0,
    ) -> None:
        super().__init__()
        self.reach, self.ahead = reach, ahead
        self.register_buffer("places", torch.tensor(places), persistent=False)
        self.pose = nn.Linear(len(places) * channels, width // 2)
        self.times = nn.Parameter(0.02 * torch.randn(steps, width // 2))
        self.whole = nn.Linear(steps * (width // 2), width)

    def forward(self, values: Tensor, poses: Tensor) -> Tensor:
        """values: [B, H, H, C]; poses: [B, K, T, 3] m, m, rad -> [B, K, W]"""
        batch, count, steps, _ = poses.shape
        points = bev_places(placed(poses, self.places), self.reach, ahead=self.ahead)
        points = points.reshape(batch, -1, 2)
        found = lookup(values, points).reshape(batch, count, steps, -1)
        return self.whole(F.relu(self.pose(found) + self.times).flatten(2))


def driven_by_car(poses: Tensor, motion: Tensor, *, dt: float) -> Tensor:
    """Return the poses [B, K, T, 3] m, m, rad of a car that tracks poses of that shape.

    motion: [B, 4] its velocity and acceleration now, m/s and m/s²; dt: s, from pose to pose
    """
    return driven(poses, Start.of(motion, wheelbase=CAR_WHEELBASE), dt=dt).poses


def placed(poses: Tensor, places: Tensor) -> Tensor:
    """Return the places [P, 2] of the car in poses [..., 3]: [..., P, 2] m."""
    cos, sin = poses[..., 2:].cos(), poses[..., 2:].sin()
    ahead, left = places.unbind(-1)
    x = poses[..., :1] + cos * ahead - sin * left
    y = poses[..., 1:2] + sin * ahead + cos * left
    return torch.stack([x, y], -1)
