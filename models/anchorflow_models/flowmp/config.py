"""The configuration of an L2 safety-embedded flow."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TransformerSize:
    width: int
    layers: int
    heads: int


VARIANTS = {
    "small": TransformerSize(width=128, layers=4, heads=4),
    "base": TransformerSize(width=256, layers=6, heads=8),
    "large": TransformerSize(width=512, layers=8, heads=16),
}


@dataclass(frozen=True)
class L2Config:
    """Everything that fixes the network's shape and its units.

    num_steps: T; dim: D; horizon_s in s, v_max in m/s, a_max in m/s^2
    map_channels: C; map_size: cells a side of the window that the network looks at
    steps_per_token: time steps that one transformer token covers
    """

    variant: str = "small"
    num_steps: int = 64
    dim: int = 2
    horizon_s: float = 8.0
    v_max: float = 2.0
    a_max: float = 3.0
    map_channels: int = 3
    map_size: int = 64
    feature_channels: int = 16
    steps_per_token: int = 8
    num_control_points: int = 18
    degree: int = 4

    @property
    def size(self) -> TransformerSize:
        return VARIANTS[self.variant]

    @property
    def state_dim(self) -> int:
        """S: position, velocity and acceleration."""
        return 3 * self.dim
