"""The vector field as a residual 1-D U-Net over time (after Diffuser; Janner et al., 2022)."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.flowmp.config import UNET_WIDTHS, check_choice, unet_width
from anchorflow_models.flowmp.transformer import VectorField, repeat_last_step
from anchorflow_models.layers.attention import MapAttention
from anchorflow_models.layers.blocks import GROUPS, FiLMBlock, zero_linear
from anchorflow_models.layers.places import sinusoidal_positions

MULTIPLIERS = (1, 2, 4, 8)  # of the width, at T, T/2, T/4 and T/8 steps
STRIDE = 2 ** (len(MULTIPLIERS) - 1)
HEAD_WIDTH = 32


class FlowMPUNet1D(VectorField):
    """Fields at x_t [B, N, T, S]; the condition enters by FiLM in every block.

    T is padded to a multiple of 8 inside. Map attention works where the steps are fewest.
    """

    positions: Tensor

    def __init__(
        self,
        width: int,
        *,
        state_dim: int,
        num_steps: int,
        feature_channels: int,
        condition_width: int,
        map_attention: bool = False,
        **time: Any,
    ) -> None:
        widths = [multiplier * width for multiplier in MULTIPLIERS]
        levels = list(pairwise(widths))
        down = [FiLMBlock(a, b) for a, b in ((width, width), *levels)]
        middle = [FiLMBlock(widths[-1], widths[-1]) for _ in range(2)]
        up = [FiLMBlock(2 * a, a) for a, _ in reversed(levels)]
        blocks = (*down, *middle, *up)
        super().__init__(
            condition_width=condition_width,
            neutral_modulation=torch.cat([block.neutral_modulation() for block in blocks]),
            **time,
        )
        self.num_steps, self.extra_steps = num_steps, -num_steps % STRIDE
        self.project_in = nn.Linear(state_dim + feature_channels, width)
        self.register_buffer("positions", sinusoidal_positions(num_steps, width))
        self.down, self.middle, self.up = map(nn.ModuleList, (down, middle, up))
        self.halvings = nn.ModuleList(_halving(a) for a in widths[:-1])
        self.doublings = nn.ModuleList(_doubling(b, a) for a, b in reversed(levels))
        self.map_attention = (
            MapAttention(widths[-1], widths[-1] // HEAD_WIDTH) if map_attention else None
        )
        self.norm = nn.GroupNorm(GROUPS, width)
        self.heads = zero_linear(width, state_dim)
        self.chunks = [block.modulation_size for block in blocks]

    def forward(
        self,
        x_t: Tensor,
        features: Tensor,
        modulation: Tensor,
        keys_values: Tensor | None = None,
    ) -> Tensor:
        """x_t: [B, N, T, S]; features: [B, N, T, F]; modulation: [B, 1 or N, M] -> [B, N, T, S]."""
        batch, count = x_t.shape[:2]
        parts = iter(modulation.split(self.chunks, -1))
        x = self.project_in(torch.cat([x_t, features], -1)) + self.positions
        x = repeat_last_step(x, self.extra_steps).flatten(0, 1).transpose(1, 2)
        x = self.down[0](x, next(parts))
        skips = []
        for halve, block in zip(self.halvings, self.down[1:], strict=True):
            skips.append(x)
            x = block(halve(x), next(parts))
        x = self.middle[0](x, next(parts))
        if self.map_attention is not None:
            assert keys_values is not None, "map attention needs the scene's keys and values"
            tokens = x.transpose(1, 2).unflatten(0, (batch, count))
            asked = self.map_attention(tokens, keys_values[:, 0])
            x = x + asked.flatten(0, 1).transpose(1, 2)
        x = self.middle[1](x, next(parts))
        for double, block in zip(self.doublings, self.up, strict=True):
            x = block(torch.cat([double(x), skips.pop()], 1), next(parts))
        fields = self.heads(F.silu(self.norm(x)).transpose(1, 2))
        return fields.unflatten(0, (batch, count))[:, :, : self.num_steps]


def _halving(channels: int) -> nn.Module:
    return nn.Conv1d(channels, channels, 3, stride=2, padding=1)


def _doubling(inputs: int, outputs: int) -> nn.Module:
    """Twice the steps: nearest neighbour, then a convolution, which leaves no checkerboard."""
    return nn.Sequential(
        nn.Upsample(scale_factor=2.0, mode="nearest"), nn.Conv1d(inputs, outputs, 3, padding=1)
    )


def create_flowmp_unet1d(
    variant: str = "small",
    *,
    state_dim: int = 7,
    num_steps: int = 64,
    feature_channels: int = 32,
    condition_width: int = 256,
    width: int = 0,
    **options: Any,
) -> FlowMPUNet1D:
    """A U-Net of a named size: "small", "base" or "large"; raises ValueError on another.

    width: 0: as that size has; options: `FlowMPUNet1D`'s others
    """
    check_choice("variant", variant, tuple(UNET_WIDTHS))
    return FlowMPUNet1D(
        unet_width(variant, width),
        state_dim=state_dim,
        num_steps=num_steps,
        feature_channels=feature_channels,
        condition_width=condition_width,
        **options,
    )
