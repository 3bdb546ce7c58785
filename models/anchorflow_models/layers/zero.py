"""Layers that start at zero."""

from __future__ import annotations

from torch import nn


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
