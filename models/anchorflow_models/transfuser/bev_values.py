"""What can be looked up in a bird's-eye view, and where."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F


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

    Its first row lies at the greatest x, its first column at the greatest y.

    reach: m from the middle of the BEV to its edges; beyond: m by which it reaches farther ahead
    ahead: m by which its middle lies before the ego
    """
    x, y = points.unbind(-1)
    half = beyond / 2
    return torch.stack([-y / reach, (ahead + half - x) / (reach + half)], -1)
