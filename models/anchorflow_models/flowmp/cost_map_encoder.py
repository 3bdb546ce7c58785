"""The map's encoder: the scene's window, a residual CNN over it, and map tokens."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.flowmp.frame import Frame
from anchorflow_models.layers.attention import MAP_TOKEN_WIDTH
from anchorflow_models.layers.blocks import ResidualBlock
from anchorflow_models.layers.places import fourier_places, lookup_at

NEAR, FAR = 0.25, 1.0  # m, the two scales at which clearance is resolved


class MapWindow(nn.Module):
    """Resamples maps of any size to the window and scales them.

    cost_map: [B, C, H, W] in [0, 1]; clearance: [B, H, W] m
    """

    def __init__(self, map_channels: int, size: int) -> None:
        super().__init__()
        self.size = size
        self.channels = 2 + map_channels

    def forward(
        self, cost_map: Tensor, map_geometry: Tensor, clearance: Tensor, frame: Frame
    ) -> Tensor:
        """[B, 2 + C, size, size]."""
        maps = torch.cat([clearance[:, None], cost_map], 1)
        size_x, size_y = torch.full((), maps.shape[3]), torch.full((), maps.shape[2])
        begin_x, begin_y, resolution = map_geometry.split(1, 1)
        extent_x, extent_y = resolution * size_x.to(maps), resolution * size_y.to(maps)
        place_x, place_y = frame.window(self.size).unbind(-1)
        x = (place_x - begin_x) / extent_x * 2 - 1
        y = (place_y - begin_y) / extent_y * 2 - 1
        # Not grid_sample: its ONNX form is newer than what some execution providers read.
        seen = lookup_at(maps.permute(0, 2, 3, 1), x, y)
        seen = seen.transpose(1, 2).unflatten(2, (self.size, self.size))
        # The clearance keeps falling beyond the map's edge.
        beyond = (x.abs() - 1).clamp(min=0) * extent_x / 2
        beyond = beyond + (y.abs() - 1).clamp(min=0) * extent_y / 2
        metres = seen[:, :1] - beyond.unflatten(1, (1, self.size, self.size))
        return torch.cat([torch.tanh(metres / NEAR), torch.tanh(metres / FAR), seen[:, 1:]], 1)


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
    up lets each place know of it, and is left out if F = 0.
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


class MapTokens(nn.Module):
    """One token a cell of the encoder's coarse grid: what is there, and where that is.

    widths: of the windows, in units of the nearest one's; each has a projection of its own
    cells: a side of the coarse grid, the same for every window
    """

    places: Tensor  # [windows, cells^2, 4 octaves]

    def __init__(self, coarse_channels: int, *, cells: int, widths: Sequence[float]) -> None:
        super().__init__()
        line = (torch.arange(cells) + 0.5) * (2.0 / cells) - 1.0
        y, x = torch.meshgrid(line, line, indexing="ij")
        centres = torch.stack([x, y], -1).reshape(-1, 2)
        places = torch.stack([fourier_places(width * centres) for width in widths])
        self.register_buffer("places", places)
        self.projections = nn.ModuleList(
            nn.Linear(coarse_channels + places.shape[-1], MAP_TOKEN_WIDTH) for _ in widths
        )
        self.norm = nn.LayerNorm(MAP_TOKEN_WIDTH)

    def forward(self, coarse: Sequence[Tensor]) -> Tensor:
        """Coarse features [B, E, cells, cells] of each window -> [B, windows * cells^2, Q]."""
        tokens = []
        for grid, places, project in zip(coarse, self.places, self.projections, strict=True):
            cells = grid.flatten(2).transpose(1, 2)
            where = places.expand(cells.shape[0], -1, -1)
            tokens.append(project(torch.cat([cells, where], -1)))
        return self.norm(torch.cat(tokens, 1))
