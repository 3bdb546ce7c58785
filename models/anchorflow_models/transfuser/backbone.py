"""The Transfuser backbone: camera and LiDAR to bird's-eye-view features (Chitta et al., PAMI 2023).

Two residual networks encode image and LiDAR; after each stage a transformer fuses them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.attention import PreNormLayer
from anchorflow_models.layers.blocks import PIXEL_MEAN, PIXEL_SPREAD, zero_conv
from anchorflow_models.transfuser.config import TransfuserConfig


@dataclass(frozen=True, eq=False)
class BevFeatures:
    """Features in bird's-eye view over the LiDAR's square.

    Row 0 lies farthest ahead, column 0 farthest left, as in every raster of driving.

    features: [B, C, h, h], 512 channels of 8 by 8 cells as published
    upscaled: [B, C', H/4, H/4], 64 channels of 64 by 64 cells as published, for semantics
    """

    features: Tensor
    upscaled: Tensor


class ResNet(nn.Module):
    """A residual network, stage by stage, made of `transformers`' ResNetBackbone.

    The names of its weights are those of the ResNetBackbone, so that pretrained ones fit.
    """

    def __init__(self, channels: int, config: TransfuserConfig) -> None:
        super().__init__()
        # Here, because it takes two seconds that no other planner should wait for.
        from transformers import ResNetBackbone, ResNetConfig

        whole = ResNetBackbone(
            ResNetConfig(
                num_channels=channels,
                embedding_size=config.stem_width,
                hidden_sizes=[*config.widths],
                depths=[*config.depths],
                layer_type="basic",
            )
        )
        self.embedder, self.encoder = whole.embedder, whole.encoder
        self.stem_pooling = config.stem_pooling

    def stem(self, x: Tensor) -> Tensor:
        return self.embedder(x) if self.stem_pooling else self.embedder.embedder(x)

    def stage(self, index: int, x: Tensor) -> Tensor:
        return self.encoder.stages[index](x)


class Fusion(nn.Module):
    """Attention between image and LiDAR features of one stage, added to both.

    Both are pooled to the grid of the last stage, a token a cell.
    """

    def __init__(self, width: int, config: TransfuserConfig) -> None:
        super().__init__()
        self.image_grid, self.lidar_grid = config.image_grid, (config.bev_size, config.bev_size)
        rows, columns = self.image_grid
        tokens = rows * columns + config.bev_size**2
        self.align_lidar = nn.Conv2d(width, width, 1)
        self.align_fused = nn.Conv2d(width, width, 1)
        self.places = nn.Parameter(torch.zeros(1, tokens, width))
        self.layers = nn.Sequential(
            *[
                PreNormLayer(width, config.fusion_heads, hidden=4 * width)
                for _ in range(config.fusion_layers)
            ],
            nn.LayerNorm(width),
        )

    def forward(self, image: Tensor, lidar: Tensor) -> tuple[Tensor, Tensor]:
        """image: [B, W, h, w]; lidar: [B, W, h', w'] -> the same"""
        seen = _pooled(image, self.image_grid)
        scanned = self.align_lidar(_pooled(lidar, self.lidar_grid))
        tokens = torch.cat([seen.flatten(2), scanned.flatten(2)], -1).transpose(1, 2)
        mixed = self.layers(tokens + self.places).transpose(1, 2)
        count = self.image_grid[0] * self.image_grid[1]
        to_image = mixed[..., :count].unflatten(-1, self.image_grid)
        to_lidar = self.align_fused(mixed[..., count:].unflatten(-1, self.lidar_grid))
        return image + _resized(to_image, image.shape), lidar + _resized(to_lidar, lidar.shape)


class FeaturePyramid(nn.Module):
    """BEV features of a width, upscaled: [B, width, h, h] -> [B, C', H/4, H/4].

    below: widths of finer features that are added before the last convolution
    """

    def __init__(self, width: int, config: TransfuserConfig, below: Sequence[int] = ()) -> None:
        super().__init__()
        channels = config.bev_channels
        self.size = config.upscaled_size
        self.lateral = nn.Conv2d(width, channels, 1)
        self.middle = nn.Conv2d(channels, channels, 3, padding=1)
        self.fine = nn.Conv2d(channels, channels, 3, padding=1)
        self.skips = nn.ModuleList(zero_conv(each, channels, 3) for each in below)

    def forward(self, features: Tensor, finer: Sequence[Tensor] = ()) -> Tensor:
        """finer: [B, W, h', h'], a tensor for each width `below`"""
        x = F.relu(self.lateral(features))
        x = F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
        x = F.relu(self.middle(x))
        x = F.interpolate(x, size=(self.size, self.size), mode="bilinear", align_corners=False)
        for skip, each in zip(self.skips, finer, strict=True):
            x = x + _resized(skip(each), x.shape)
        return F.relu(self.fine(x))


class TransfuserBackbone(nn.Module):
    """Camera and LiDAR to BEV features."""

    pixel_mean: Tensor
    pixel_spread: Tensor

    def __init__(self, config: TransfuserConfig) -> None:
        super().__init__()
        self.config = config
        self.image, self.lidar = ResNet(3, config), ResNet(2 if config.lidar_before else 1, config)
        self.fusions = nn.ModuleList(Fusion(width, config) for width in config.widths)
        below = config.widths[:-1] if config.pyramid_skips else ()
        self.pyramid = FeaturePyramid(config.bev_width, config, below)
        for name, values in (("pixel_mean", PIXEL_MEAN), ("pixel_spread", PIXEL_SPREAD)):
            self.register_buffer(name, 255 * torch.tensor(values)[:, None, None], persistent=False)

    def forward(
        self, camera: Tensor, lidar: Tensor, lidar_before: Tensor | None = None
    ) -> BevFeatures:
        """camera: uint8 [B, 3, H, W]; lidar: [B, 1, H', H'] in [0, 1], as its histogram has it:
        row 0 lies farthest behind, column 0 farthest right; lidar_before: likewise, zeros where
        there is none, for a backbone that reads it"""
        if self.config.lidar_before:
            before = torch.zeros_like(lidar) if lidar_before is None else lidar_before
            lidar = torch.cat([lidar, before], 1)
        image = self.image.stem((camera.float() - self.pixel_mean) / self.pixel_spread)
        bev = self.lidar.stem(lidar.flip(-2, -1))
        scales = []
        for index, fusion in enumerate(self.fusions):
            image, bev = self.image.stage(index, image), self.lidar.stage(index, bev)
            image, bev = fusion(image, bev)
            scales.append(bev)
        finer = scales[:-1] if self.config.pyramid_skips else ()
        return BevFeatures(bev, self.pyramid(bev, finer))


def _pooled(x: Tensor, grid: tuple[int, int]) -> Tensor:
    """The mean of each of a grid's cells, which divide the features evenly."""
    return F.avg_pool2d(x, (x.shape[-2] // grid[0], x.shape[-1] // grid[1]))


def _resized(x: Tensor, shape: torch.Size) -> Tensor:
    size = [int(cells) for cells in shape[-2:]]
    return F.interpolate(x, size=size, mode="bilinear", align_corners=False)
