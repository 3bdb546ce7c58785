"""A number of a feature."""

from __future__ import annotations

from torch import nn


def scalar_head(width: int) -> nn.Sequential:
    """[..., width] -> [..., 1]"""
    return nn.Sequential(nn.Linear(width, width // 2), nn.ReLU(), nn.Linear(width // 2, 1))
