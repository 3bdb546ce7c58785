"""Warm starts: a known trajectory as the state that the flow would have near its end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import WarmStart
from anchorflow_client.errors import InvalidRequest
from anchorflow_trajectory.resample import resampled_states, whole_fields

Array = NDArray[np.float32]


def warm_state(warm_start: WarmStart, *, dim: int, num_steps: int, horizon_s: float) -> Array:
    """The trajectory as a state x_1 [T,S]: resampled to T steps, missing derivatives from splines.

    Raises:
        InvalidRequest: its columns are not whole positions, velocities and accelerations.
    """
    trajectory = warm_start.trajectory
    columns = trajectory.shape[1]
    if not whole_fields(columns, dim):
        widths = ", ".join(str(dim * blocks) for blocks in (1, 2, 3))
        raise InvalidRequest(
            f"expected [T,{dim}] of positions, with velocities or with accelerations too "
            f"({widths} columns), got {columns} columns",
            "warm_start.trajectory",
        )
    return resampled_states(trajectory, dim=dim, num_steps=num_steps, horizon_s=horizon_s)


def renoised(x_1: Array, x_0: Array, tau: float) -> Array:
    """x_tau = tau x_1 + (1 - tau) x_0, [N,T,S]."""
    return np.float32(tau) * x_1 + np.float32(1.0 - tau) * x_0
