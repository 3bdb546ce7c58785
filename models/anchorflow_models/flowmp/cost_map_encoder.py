"""The map's encoder: a residual CNN over the scene's window, with a way back up to full size."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.residual import ResidualBlock

WIDTHS = (48, 64, 96)  # channels at a half, a quarter and an eighth of the window's size


class CostMapEncoder(nn.Module):
    """[B, C, H, W] -> features [B, H, W, F] to look up along trajectories, and a summary [B, G].

    H and W are multiples of 8. The way down gathers what is where on the whole window; the way back
    up lets each place know of it.
    """

    def __init__(self, channels: int, features: int, *, widths: tuple[int, ...] = WIDTHS) -> None:
        super().__init__()
        high, middle, low = widths
        self.fold = nn.PixelUnshuffle(2)
        self.stem = nn.Conv2d(4 * channels, high, 3, padding=1)
        self.high = ResidualBlock(high)
        self.to_middle = nn.Conv2d(high, middle, 3, stride=2, padding=1)
        self.middle = ResidualBlock(middle)
        self.to_low = nn.Conv2d(middle, low, 3, stride=2, padding=1)
        self.low = nn.Sequential(ResidualBlock(low), ResidualBlock(low))
        self.back_to_middle = nn.Conv2d(low, middle, 1)
        self.middle_again = ResidualBlock(middle)
        self.back_to_high = nn.Conv2d(middle, high, 1)
        self.high_again = ResidualBlock(high)
        self.out = nn.Sequential(nn.SiLU(), nn.Conv2d(high, 4 * features, 1), nn.PixelShuffle(2))

    @property
    def summary_size(self) -> int:
        return 2 * self.low[0].body[0].num_channels

    def forward(self, maps: Tensor) -> tuple[Tensor, Tensor]:
        high = self.high(self.stem(self.fold(maps)))
        middle = self.middle(self.to_middle(high))
        low = self.low(self.to_low(middle))
        middle = self.middle_again(middle + _double(self.back_to_middle(low)))
        high = self.high_again(high + _double(self.back_to_high(middle)))
        summary = torch.cat([low.mean((2, 3)), low.amax((2, 3))], -1)
        return self.out(high).permute(0, 2, 3, 1), summary


def _double(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")
