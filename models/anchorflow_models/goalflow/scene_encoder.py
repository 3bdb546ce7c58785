"""The scene: a raster and the ego's status as features of places and as one vector."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.blocks import ResidualBlock
from anchorflow_models.transfuser import STATUS

STRIDE = 4  # cells of the raster a side of a cell of the features
VELOCITY = 4  # in the ego status, the first of two


class SceneEncoder(nn.Module):
    """A small feature pyramid over the raster: strides 4, 8 and 16, and back up to 4."""

    def __init__(self, *, inputs: int, channels: int, features: int, context: int) -> None:
        super().__init__()
        fine, middle, coarse = channels, 2 * channels, 3 * channels
        self.stem = nn.Conv2d(inputs, fine, STRIDE, stride=STRIDE)
        self.middle = nn.Conv2d(fine, middle, 3, stride=2, padding=1)
        self.coarse = nn.Conv2d(middle, coarse, 3, stride=2, padding=1)
        self.blocks = nn.ModuleList(ResidualBlock(width) for width in (middle, coarse))
        self.to_middle = nn.Conv2d(coarse, middle, 1)
        self.to_fine = nn.Conv2d(middle, fine, 1)
        self.mix = nn.Conv2d(fine, fine, 3, padding=1)
        self.out = nn.Conv2d(fine, features, 1)
        self.context = nn.Sequential(
            nn.Linear(2 * coarse + STATUS + 2, context), nn.SiLU(), nn.Linear(context, context)
        )

    def forward(self, bev: Tensor, status: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
        """bev [B, C, H, W] from 0 to 1; status [B, 8]; size [B, 2] of the ego, m.

        Returns features [B, H/4, W/4, F] and context [B, E].
        """
        fine = F.silu(self.stem(bev))
        middle = self.blocks[0](self.middle(fine))
        coarse = self.blocks[1](self.coarse(F.silu(middle)))
        up = middle + F.interpolate(self.to_middle(coarse), scale_factor=2.0)
        up = fine + F.interpolate(self.to_fine(F.silu(up)), scale_factor=2.0)
        features = self.out(F.silu(self.mix(F.silu(up)))).permute(0, 2, 3, 1)
        summary = [coarse.mean((2, 3)), coarse.amax((2, 3))]
        return features, self.context(torch.cat([*summary, _in_units(status), size / 5.0], -1))


def _in_units(status: Tensor) -> Tensor:
    """Velocities in tens of m/s, accelerations in threes of m/s²."""
    command, velocity, acceleration = status.split([VELOCITY, 2, 2], -1)
    return torch.cat([command, velocity / 10.0, acceleration / 3.0], -1)
