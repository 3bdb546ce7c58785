"""Poses along an anchor, with a heading whether its planner gives one or not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch

Array = NDArray[np.float64]

MOVING = 0.05
"""m/s; slower anchors give no heading, and keep the last one."""


def poses_of(batch: AnchorBatch, index: int) -> Array:
    """Return [T,3] x, y, heading; without headings those of the velocity."""
    path = batch.trajectories[index].astype(np.float64)
    if path.shape[1] > 2:
        return path
    velocity = batch.velocities[index, :, :2].astype(np.float64)
    moving = np.hypot(*velocity.T) > MOVING
    if not moving.any():
        return np.column_stack([path, np.zeros(len(path))])
    last = np.maximum.accumulate(np.where(moving, np.arange(len(path)), -1))
    last[last < 0] = int(moving.argmax())
    return np.column_stack([path, np.arctan2(velocity[last, 1], velocity[last, 0])])
