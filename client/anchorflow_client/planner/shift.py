"""Time passes: an anchor as it looks from a later moment."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import AnchorBatch

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Steps past the last one that are none."""


def states_of(batch: AnchorBatch) -> Array:
    """[N,T,3D] position, velocity and acceleration of every anchor."""
    fields = (batch.trajectories, batch.velocities, batch.accelerations)
    return np.concatenate(fields, axis=-1, dtype=np.float64)


def shifted(
    states: Array, *, dt: ArrayLike, elapsed_s: float, later_dt: ArrayLike | None = None
) -> Array:
    """States [...,T,3D] as seen `elapsed_s` later: what is left of them, again at T steps.

    In between the samples they are interpolated linearly. Past the last one the motion goes on at
    its last velocity without acceleration.

    Args:
        states: position, velocity and acceleration.
        dt: s between two samples, one number, or [...] for motions of their own durations.
        elapsed_s: how much later.
        later_dt: s between two samples of what is given back; as `dt` unless told.
    """
    steps, dim = states.shape[-2], states.shape[-1] // 3
    step = np.asarray(dt, dtype=np.float64)[..., None]
    later_step = step if later_dt is None else np.asarray(later_dt, dtype=np.float64)[..., None]
    at = np.arange(steps) * (later_step / step) + elapsed_s / step
    at = np.broadcast_to(at, states.shape[:-1])
    low = np.minimum(at.astype(int), steps - 2)
    share = np.minimum(at - low, 1.0)[..., None]
    before, after = (np.take_along_axis(states, k[..., None], axis=-2) for k in (low, low + 1))
    later = (1.0 - share) * before + share * after
    beyond = np.maximum(at - (steps - 1), 0.0)[..., None]
    later[..., :dim] += beyond * step[..., None] * states[..., -1:, dim : 2 * dim]
    later[beyond[..., 0] > ROUNDING, 2 * dim :] = 0.0
    return later
