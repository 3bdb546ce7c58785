"""Residual blocks, heads, and layers that start at zero."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

PIXEL_MEAN = (0.485, 0.456, 0.406)
PIXEL_SPREAD = (0.229, 0.224, 0.225)


def zero_linear(inputs: int, outputs: int) -> nn.Linear:
    """A linear layer that starts at zero, so that its branch starts as the identity."""
    layer = nn.Linear(inputs, outputs)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def zero_conv(channels: int, outputs: int, kernel: int) -> nn.Conv2d:
    """A convolution of the same size that starts at zero, likewise."""
    layer = nn.Conv2d(channels, outputs, kernel, padding=kernel // 2, bias=False)
    nn.init.zeros_(layer.weight)
    return layer


def scalar_head(width: int) -> nn.Sequential:
    """[..., width] -> [..., 1]"""
    return nn.Sequential(nn.Linear(width, width // 2), nn.ReLU(), nn.Linear(width // 2, 1))


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions beside an identity: [B, C, H, W] -> the same."""

    def __init__(self, channels: int, *, groups: int = 8) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.GroupNorm(groups, channels),
            nn.SiLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.GroupNorm(groups, channels),
            nn.SiLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
        )

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x)


KERNEL = 3
GROUPS = 8


class FiLMBlock(nn.Module):
    """Two convolutions over time beside a shortcut; the condition scales and shifts in between.

    h = conv(silu(norm(x))); out = x + conv(silu(scale * norm(h) + shift))
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm_in = nn.GroupNorm(GROUPS, inputs)
        self.conv_in = nn.Conv1d(inputs, outputs, KERNEL, padding=KERNEL // 2)
        self.norm_out = nn.GroupNorm(GROUPS, outputs)
        self.conv_out = nn.Conv1d(outputs, outputs, KERNEL, padding=KERNEL // 2)
        self.shortcut = nn.Conv1d(inputs, outputs, 1) if inputs != outputs else nn.Identity()
        self.modulation_size = 2 * outputs

    def neutral_modulation(self) -> Tensor:
        """[2 C']: shifts of 0 and scales of 1."""
        return torch.cat(
            [torch.zeros(self.modulation_size // 2), torch.ones(self.modulation_size // 2)]
        )

    def forward(self, x: Tensor, modulation: Tensor) -> Tensor:
        """x: [B * N, C, T]; modulation: [B, 1 or N, 2 C'] -> [B * N, C', T]."""
        h = self.norm_out(self.conv_in(F.silu(self.norm_in(x))))
        by_scene = h.reshape(modulation.shape[0], -1, *h.shape[1:])
        shift, scale = modulation[..., None].chunk(2, -2)
        h = (by_scene * scale + shift).reshape(h.shape)
        return self.shortcut(x) + self.conv_out(F.silu(h))
