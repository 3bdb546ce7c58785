"""The way left from the end of a motion, which is measured along clear anchors.

Anchors reach beyond the controller's horizon. Without any, the straight line to the goal counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.surroundings import Grid, value_at
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

OFF_PATH_COST = np.float32(1.5)  # m of way per metre away from the nearest point
BLOCKED_COST = np.float32(3.0)  # m of way for an obstacle between a place and its path
NARROWER = np.float32(0.12)  # m, by which a straight line is narrower than the body
SIGHT_POINTS = 6  # checked between a place and its path
NONE, ONE, FAR = np.float32(0.0), np.float32(1.0), np.float32(1e9)
SPACING = 0.15  # m between the points kept of a path
MAX_POINTS = 48  # of a path


class WayLeft(NamedTuple):
    """points: [P,3], x and y in m of points on anchors, and m left from each to the goal.

    sight: m to obstacles, below which a straight line does not pass
    """

    points: Floats
    sight: np.float32

    @staticmethod
    def straight() -> WayLeft:
        """Return the way of robots without anchors."""
        return WayLeft(np.zeros((0, 3), np.float32), NONE)

    @staticmethod
    def sight_of(discs: Floats) -> np.float32:
        """Return the sight of a body of discs [J,3], the largest first."""
        return max(discs[0, 2] - NARROWER, NONE)


@compiled
def metres_left(
    points: Floats, sight: np.float32, distance: Grid, goal: Floats, states: Floats, left: Floats
) -> None:
    """Write m [K] from the ends of motions [K,T,5] to a point of an anchor and along it.

    An obstacle on the straight line to the point adds BLOCKED_COST. Without points [P,3] it is the
    straight line to the goal [2].
    """
    end = states.shape[1] - 1
    for k in range(len(states)):
        x, y = states[k, end, 0], states[k, end, 1]
        across, along = x - goal[0], y - goal[1]
        left[k] = np.sqrt(across * across + along * along)
        if not len(points):
            continue
        least, nearest = FAR, 0
        for i in range(len(points)):
            across, along = x - points[i, 0], y - points[i, 1]
            metres = points[i, 2] + OFF_PATH_COST * np.sqrt(across * across + along * along)
            if metres < least:
                least, nearest = metres, i
        by_x, by_y = points[nearest, 0] - x, points[nearest, 1] - y
        room = FAR
        for i in range(SIGHT_POINTS):
            share = np.float32(i / (SIGHT_POINTS - 1))
            room = min(room, value_at(distance, x + share * by_x, y + share * by_y))
        left[k] = least + BLOCKED_COST if room < sight else least


@compiled
def ways_along(surcharge: Grid, motions: Floats, ways: Floats) -> None:
    """Write m of way [A,S] from the beginning of motions [A,S,5]; soft costs count as detours."""
    for k in range(len(motions)):
        way = NONE
        ways[k, 0] = way
        for s in range(1, motions.shape[1]):
            x, y = motions[k, s, 0], motions[k, s, 1]
            across, along = x - motions[k, s - 1, 0], y - motions[k, s - 1, 1]
            dear = ONE + value_at(surcharge, x, y)
            way += dear * np.sqrt(across * across + along * along)
            ways[k, s] = way


def points_along(motions: Floats, ways: Floats, beyond: Floats, reach: float) -> Floats:
    """Return [P,3], points of motions [A,S,5] and m left from each to the goal.

    ways: [A,S] m; beyond: [A] m, from the end of each to the goal; reach: m, from the origin; only
    points about as near count
    """
    longest = min(float(ways[:, -1].max()), 2.0 * reach)
    count = int(min(MAX_POINTS, max(2.0, longest / SPACING)))
    wanted = np.linspace(0.0, longest, count, dtype=np.float32)
    # The first sample from each length on; those that stand still at the end add nothing.
    index = np.minimum((ways[:, None] < wanted[:, None]).sum(-1), ways.shape[1] - 1)
    rows = np.arange(len(ways))[:, None]
    left = ways[:, -1:] - ways[rows, index] + beyond[:, None]
    points = np.concatenate([motions[rows, index, :2], left[..., None]], -1)
    return np.ascontiguousarray(points.reshape(-1, 3), np.float32)
