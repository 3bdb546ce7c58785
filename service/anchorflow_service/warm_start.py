"""Warm starts: a known trajectory as the state that the flow would have near its end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from anchorflow_client.contract import ModelCard, WarmStart
from anchorflow_client.errors import InvalidRequest

Array = NDArray[np.float32]


def warm_state(warm_start: WarmStart, *, card: ModelCard, horizon_s: float) -> Array:
    """The trajectory as a state x_1 [T,S]: resampled to T steps, missing derivatives from splines.

    Raises:
        InvalidRequest: its columns are not whole positions, velocities and accelerations.
    """
    trajectory = warm_start.trajectory
    steps, columns = trajectory.shape
    if columns % card.D or columns > 3 * card.D:
        widths = ", ".join(str(card.D * blocks) for blocks in (1, 2, 3))
        raise InvalidRequest(
            f"expected [T,{card.D}] of positions, with velocities or with accelerations too "
            f"({widths} columns), got {columns} columns",
            "warm_start.trajectory",
        )
    spline = CubicSpline(np.linspace(0.0, horizon_s, steps), trajectory)
    times = np.linspace(0.0, horizon_s, card.T)
    given = spline(times)
    missing = 3 - columns // card.D
    derived = [spline(times, order)[:, -card.D :] for order in range(1, missing + 1)]
    return np.concatenate([given, *derived], axis=1).astype(np.float32)


def renoised(x_1: Array, x_0: Array, tau: float) -> Array:
    """x_tau = tau x_1 + (1 - tau) x_0, [N,T,S]."""
    return np.float32(tau) * x_1 + np.float32(1.0 - tau) * x_0
