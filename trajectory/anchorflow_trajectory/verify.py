"""Is a trajectory safe? Clearance along the whole path, speed and acceleration at its samples.

The service's `safe`, the expert's `good` and the trainer's scores are this one verdict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.clearance import GridField, path_clearance
from anchorflow_trajectory.cost import MotionLimits

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

CHECK_STEP = 0.04  # m between the points at which clearance is looked up
# A bilinear field and another reader's rounding to cells differ by less than this share of a cell.
SHARE_OF_CELL = 0.3
SPEED_TOLERANCE, ACCELERATION_TOLERANCE = 1.02, 1.05


@dataclass(frozen=True)
class Verdict:
    """What holds for each of M trajectories, all [M].

    clearance: m beyond the robot's radius, smallest along the path
    free: clear of every obstacle and of the map's edge; feasible: within both limits
    """

    clearance: FloatArray
    free: BoolArray
    feasible: BoolArray

    @property
    def safe(self) -> BoolArray:
        """Free and feasible."""
        return self.free & self.feasible


def verify(
    states: tuple[FloatArray, FloatArray, FloatArray], field: GridField, limits: MotionLimits
) -> Verdict:
    """Judge positions, velocities and accelerations [M, T, D]."""
    position, velocity, acceleration = states
    clearance = path_clearance(field, position, max_step=CHECK_STEP)
    free = clearance >= SHARE_OF_CELL * field.resolution
    feasible = _largest(velocity) <= SPEED_TOLERANCE * limits.v_max
    feasible &= _largest(acceleration) <= ACCELERATION_TOLERANCE * limits.a_max
    return Verdict(clearance, free, feasible)


def _largest(vectors: FloatArray) -> FloatArray:
    """Greatest planar length along each trajectory: [M, T, D] -> [M]."""
    return np.sqrt((vectors[..., :2] ** 2).sum(-1)).max(1)
