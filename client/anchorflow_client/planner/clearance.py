"""Clearance of one place, as the service measures it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OCCUPIED, CostMap

SHARE_OF_CELL = 0.3
"""Of a cell: what the service asks for beyond the certified margin, for other readers' rounding
(`anchorflow_trajectory.verify`)."""

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def obstacle_distance(cost_map: CostMap, place: Array) -> float:
    """m from a place [2] to the nearest occupied cell of a map [C,H,W]; infinite where none is.

    Bilinear between the four cell centres around the place, each of which is measured to the
    nearest occupied square; those inside obstacles count less than 0. The service measures the
    square whose centre is nearest, and may find 0.21 of a cell more.
    """
    occupied = cost_map.occupancy >= OCCUPIED
    if not occupied.any():
        return np.inf
    last = np.array(occupied.shape[::-1]) - 1
    at = np.clip((place - cost_map.origin) / cost_map.resolution - 0.5, 0, last)
    low = np.minimum(at.astype(int), last - 1)
    share = at - low
    found = 0.0
    for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column, row = low[0] + x, low[1] + y
        weight = abs(1 - x - share[0]) * abs(1 - y - share[1])
        found += weight * _signed_distance(occupied, row, column)
    return found * cost_map.resolution


def start_clearance(cost_map: CostMap, place: Array, robot_radius: float) -> float:
    """m between a robot at a place [2] and the nearest obstacle or, if less, from it to the edge.

    The edge is measured to the robot's centre.
    """
    low, high = cost_map.extent
    to_edge = float(np.minimum(place - low, high - place).min())
    return min(obstacle_distance(cost_map, place) - robot_radius, to_edge)


def _signed_distance(occupied: BoolArray, row: int, column: int) -> float:
    """In cells, from a cell's centre to the others' squares."""
    inside = bool(occupied[row, column])
    apart = np.abs(np.argwhere(occupied != inside) - (row, column)) - 0.5
    squared = (np.maximum(apart, 0.0) ** 2).sum(1).min(initial=sum(occupied.shape) ** 2)
    return -float(np.sqrt(squared)) if inside else float(np.sqrt(squared))
