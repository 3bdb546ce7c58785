"""Is a trajectory safe? Clearance along the whole path, speed and acceleration at its samples.

The service's `safe`, the expert's `good` and the trainer's scores are this one verdict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.clearance import GridField
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.cost_fields import Grid, look_up

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
    clearance = path_clearance(field, position)
    free = clearance >= required_clearance(field, certified_margin)
    feasible = largest_length(velocity) <= SPEED_TOLERANCE * limits.v_max
    feasible &= largest_length(acceleration) <= ACCELERATION_TOLERANCE * limits.a_max
    return Verdict(clearance, free, feasible)


def required_clearance(field: GridField, certified_margin: float) -> float:
    """m of clearance in the field from which a path is certified to keep the margin."""
    return certified_margin + SHARE_OF_CELL * field.resolution


def path_clearance(
    field: GridField, positions: FloatArray, *, max_step: float = CHECK_STEP
) -> FloatArray:
    """Smallest clearance [m] along each polyline; positions [M, T, D >= 2] -> [M].

    Between two samples the polyline is followed at steps of at most `max_step` metres.
    """
    positions = np.ascontiguousarray(positions)
    return _least_values(Grid.of(field, positions.dtype), positions, max_step)


@compiled
def _least_values(grid: Grid, positions: FloatArray, max_step: float) -> FloatArray:
    """The smallest value of a field along each polyline [M, T, D]: [M]."""
    count, steps, _ = positions.shape
    least = np.empty(count, positions.dtype)
    for m in range(count):
        least[m] = look_up(grid, positions[m, steps - 1, 0], positions[m, steps - 1, 1])[0]
        for t in range(steps - 1):
            x, y = positions[m, t, 0], positions[m, t, 1]
            along_x, along_y = positions[m, t + 1, 0] - x, positions[m, t + 1, 1] - y
            pieces = max(1, int(np.ceil(np.sqrt(along_x**2 + along_y**2) / max_step)))
            for piece in range(pieces):
                share = positions.dtype.type(piece / pieces)
                value = look_up(grid, x + share * along_x, y + share * along_y)[0]
                least[m] = min(least[m], value)
    return least


def largest_length(vectors: FloatArray) -> FloatArray:
    """Greatest planar length along each trajectory: [M, T, D] -> [M]."""
    return _largest_length(np.ascontiguousarray(vectors))


@compiled
def _largest_length(vectors: FloatArray) -> FloatArray:
    count, steps, _ = vectors.shape
    largest = np.zeros(count, vectors.dtype)
    for m in range(count):
        for t in range(steps):
            x, y = vectors[m, t, 0], vectors[m, t, 1]
            largest[m] = max(largest[m], x * x + y * y)
    return np.sqrt(largest)
