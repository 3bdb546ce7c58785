"""The named styles: what an anchor is good for, as words in place of three weights."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

STYLES: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "conservative": (0.8, 0.1, 0.1),
        "balanced": (0.4, 0.3, 0.3),
        "efficient": (0.1, 0.8, 0.1),
        "comfortable": (0.1, 0.1, 0.8),
    }
)
"""Weights of safety, energy and smoothness that each name stands for.

conservative   far from obstacles, and slow
balanced       a bit of each
efficient      short and quick
comfortable    little jerk
"""

DEFAULT_STYLE = STYLES["balanced"]
"""Of a request that says nothing."""
