"""Time passes: an anchor as it looks from a later moment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch

Array = NDArray[np.float64]


def states_of(batch: AnchorBatch) -> Array:
    """[N,T,3D] position, velocity and acceleration of every anchor."""
    fields = (batch.trajectories, batch.velocities, batch.accelerations)
    return np.concatenate(fields, axis=-1, dtype=np.float64)


def shifted(states: Array, *, dt: float, elapsed_s: float) -> Array:
    """States [...,T,3D] as seen `elapsed_s` later: what is left of them, again at T steps of dt.

    In between the samples they are interpolated linearly. Past the last one the motion goes on at
    its last velocity without acceleration.
    """
    steps = states.shape[-2]
    at = np.arange(steps) + elapsed_s / dt
    low = np.minimum(at.astype(int), steps - 2)
    share = np.minimum(at - low, 1.0)[:, None]
    later = (1.0 - share) * states[..., low, :] + share * states[..., low + 1, :]
    beyond_s = dt * np.maximum(at - (steps - 1), 0.0)[:, None]
    dim = states.shape[-1] // 3
    later[..., :dim] += beyond_s * states[..., -1:, dim : 2 * dim]
    later[..., beyond_s[:, 0] > 0, 2 * dim :] = 0.0
    return later
