"""The map's encoder: a residual CNN over a window, with a way back up to full size."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.residual import ResidualBlock

WIDTHS = (48, 64, 96)  # channels at a half, a quarter and an eighth of the window's size


class MapEncoding(NamedTuple):
    """One window, told three ways.

    features: [B, H, W, F] to look up along trajectories; None where F = 0
    coarse: [B, E, H / 8, W / 8], what is where
    summary: [B, G], what there is
    """

    features: Tensor | None
    coarse: Tensor
    summary: Tensor


class CostMapEncoder(nn.Module):
    """Maps [B, C, H, W] of any number of channels -> `MapEncoding`.

    H and W are multiples of 8. The way down gathers what is where on the whole window; the way back
    up lets each place know of it, and is left out where no features are asked for.
    """

    def __init__(self, channels: int, features: int, *, widths: tuple[int, ...] = WIDTHS) -> None:
        super().__init__()
        high, middle, low = widths
        self.coarse_channels, self.summary_size = low, 2 * low
        self.fold = nn.PixelUnshuffle(2)
        self.stem = nn.Conv2d(4 * channels, high, 3, padding=1)
        self.high = ResidualBlock(high)
        self.to_middle = nn.Conv2d(high, middle, 3, stride=2, padding=1)
        self.middle = ResidualBlock(middle)
        self.to_low = nn.Conv2d(middle, low, 3, stride=2, padding=1)
        self.low = nn.Sequential(ResidualBlock(low), ResidualBlock(low))
        self.has_features = features > 0
        if self.has_features:
            self.back_to_middle = nn.Conv2d(low, middle, 1)
            self.middle_again = ResidualBlock(middle)
            self.back_to_high = nn.Conv2d(middle, high, 1)
            self.high_again = ResidualBlock(high)
            self.out = nn.Sequential(nn.SiLU(), nn.Conv2d(high, 4 * features, 1))

    def forward(self, maps: Tensor) -> MapEncoding:
        high = self.high(self.stem(self.fold(maps)))
        middle = self.middle(self.to_middle(high))
        low = self.low(self.to_low(middle))
        summary = torch.cat([low.mean((2, 3)), low.amax((2, 3))], -1)
        features = self._features(high, middle, low) if self.has_features else None
        return MapEncoding(features, low, summary)

    def _features(self, high: Tensor, middle: Tensor, low: Tensor) -> Tensor:
        middle = self.middle_again(middle + _double(self.back_to_middle(low)))
        high = self.high_again(high + _double(self.back_to_high(middle)))
        activation, last = self.out
        assert isinstance(last, nn.Conv2d)
        assert last.bias is not None
        # nn.PixelShuffle(2), channels last. With the features of a place beside each other before
        # places are put in rows, whole rows are moved and not numbers.
        kernel = _places_first(last.weight)
        folded = F.conv2d(activation(high), kernel, _places_first(last.bias)).permute(0, 2, 3, 1)
        rows = folded.unflatten(3, (2, -1)).transpose(2, 3).flatten(1, 2)
        return rows.unflatten(3, (2, -1)).flatten(2, 3)


def _places_first(weights: Tensor) -> Tensor:
    """Weights [F * 4, ...] of features at four places each, as [4 * F, ...]."""
    return weights.unflatten(0, (-1, 4)).transpose(0, 1).flatten(0, 1)


def _double(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")
