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
    free: clear of every obstacle and of the map's edge by the certified margin
    feasible: within both limits
    """

    clearance: FloatArray
    free: BoolArray
    feasible: BoolArray

    @property
    def safe(self) -> BoolArray:
        """Free and feasible."""
        return self.free & self.feasible


def verify(
    states: tuple[FloatArray, FloatArray, FloatArray],
    field: GridField,
    limits: MotionLimits,
    *,
    certified_margin: float = 0.0,
) -> Verdict:
    """Judge positions, velocities and accelerations [M, T, D].

    certified_margin: m beyond the robot's radius that a safe path keeps from every obstacle and
        from the map's edge; the share of a cell comes on top, so it holds for another reader too
    """
    position, velocity, acceleration = states
    clearance = path_clearance(field, position, max_step=CHECK_STEP)
    free = clearance >= required_clearance(field, certified_margin)
    feasible = _largest(velocity) <= SPEED_TOLERANCE * limits.v_max
    feasible &= _largest(acceleration) <= ACCELERATION_TOLERANCE * limits.a_max
    return Verdict(clearance, free, feasible)


def required_clearance(field: GridField, certified_margin: float) -> float:
    """m of clearance in the field from which a path is certified to keep the margin."""
    return certified_margin + SHARE_OF_CELL * field.resolution


def _largest(vectors: FloatArray) -> FloatArray:
    """Greatest planar length along each trajectory: [M, T, D] -> [M]."""
    return np.sqrt((vectors[..., :2] ** 2).sum(-1)).max(1)
