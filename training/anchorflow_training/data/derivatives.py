"""Derivatives of sampled trajectories."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HEADING = 2  # the column of a heading, where D = 3


def central_differences(
    values: NDArray[np.floating], dt: float | NDArray[np.floating]
) -> NDArray[np.floating]:
    """d/dt of samples [..., T, D] that are `dt` seconds apart, T >= 3; dt may be [...].

    Central inside, one-sided over three points at both ends: exact for parabolas everywhere.
    """
    return np.gradient(values, axis=-2, edge_order=2) / np.asarray(dt)[..., None, None]


def unwrap_heading(positions: NDArray[np.floating]) -> NDArray[np.floating]:
    """Positions [..., T, D] whose heading, if any, runs on beyond pi from a start within it."""
    if positions.shape[-1] <= HEADING:
        return positions
    heading = np.unwrap(positions[..., HEADING], axis=-1)
    turns = np.round(heading[..., :1] / (2 * np.pi)) * (2 * np.pi)
    return np.concatenate([positions[..., :HEADING], (heading - turns)[..., None]], -1)
