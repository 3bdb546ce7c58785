"""The way left from the end of a motion, which is measured along clear anchors.

Anchors reach beyond the controller's horizon. Without any, the straight line to the goal counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.anchor_motions import nearest_sample
from anchorflow_control.dynamics import within
from anchorflow_control.surroundings import Grid, value_at
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

OFF_PATH_COST = np.float32(1.5)  # m of way per metre away from the nearest point
NEAR_COST = np.float32(6.0)  # the same, for the point that is taken behind an obstacle
BLOCKED_COST = np.float32(3.0)  # m of way for an obstacle between a place and its path
NARROWER = np.float32(0.12)  # m, by which a straight line is narrower than the body
SIGHT_POINTS = 6  # checked between a place and its path
NONE, ONE, FAR = np.float32(0.0), np.float32(1.0), np.float32(1e9)
SPACING = 0.15  # m between the points kept of a path
MAX_POINTS = 48  # of a path


class WayLeft(NamedTuple):
    """points: [3,P], x and y in m of points on anchors, and m left from each to the goal.

    sight: m to obstacles, below which a straight line does not pass
    off_path: m of way per metre away from the nearest point; more than dear ground costs, since
        else leaving the anchor would pay more than driving along it
    """

    points: Floats
    sight: np.float32
    off_path: np.float32 = OFF_PATH_COST

    @staticmethod
    def straight() -> WayLeft:
        """Return the way of robots without anchors."""
        return WayLeft(np.zeros((3, 0), np.float32), NONE, OFF_PATH_COST)

    @staticmethod
    def sight_of(discs: Floats) -> np.float32:
        """Return the sight of a body of discs [J,3], the largest first."""
        return max(discs[0, 2] - NARROWER, NONE)


@compiled
def metres_left(
    points: Floats,
    sight: np.float32,
    off_path: np.float32,
    distance: Grid,
    goal: Floats,
    states: Floats,
    left: Floats,
) -> None:
    """Write m [K] from the ends of motions [K,T,5] to a point of an anchor and along it.

    The way is shortest by the chosen point. If an obstacle hides that point, a near one is chosen;
    if one hides that too, BLOCKED_COST is added. Without points [3,P] the way is the straight line
    to the goal [2].
    """
    x, y = states[:, -1, 0].copy(), states[:, -1, 1].copy()
    if not points.shape[1]:
        for k in range(len(left)):
            across, along = x[k] - goal[0], y[k] - goal[1]
            left[k] = np.sqrt(across * across + along * along)
        return
    best, near = np.zeros(len(left), np.int32), np.zeros(len(left), np.int32)
    least = np.full(len(left), FAR, np.float32)
    left[:] = FAR
    for i in range(points.shape[1]):
        to_x, to_y, beyond, index = points[0, i], points[1, i], points[2, i], np.int32(i)
        # Without a branch, so that it runs on several motions at once.
        for k in range(len(left)):
            across, along = x[k] - to_x, y[k] - to_y
            apart = np.sqrt(across * across + along * along)
            metres = beyond + off_path * apart
            best[k] = index if metres < left[k] else best[k]
            left[k] = min(metres, left[k])
            metres = beyond + max(NEAR_COST, off_path) * apart
            near[k] = index if metres < least[k] else near[k]
            least[k] = min(metres, least[k])
    for k in range(len(left)):
        if _sees(distance, sight, x[k], y[k], points[0, best[k]], points[1, best[k]]):
            continue
        to_x, to_y = points[0, near[k]], points[1, near[k]]
        across, along = x[k] - to_x, y[k] - to_y
        left[k] = points[2, near[k]] + off_path * np.sqrt(across * across + along * along)
        if not _sees(distance, sight, x[k], y[k], to_x, to_y):
            left[k] += BLOCKED_COST


@compiled
def _sees(
    distance: Grid,
    sight: np.float32,
    x: np.float32,
    y: np.float32,
    to_x: np.float32,
    to_y: np.float32,
) -> bool:
    """Return whether the straight line between two places keeps `sight` m from obstacles."""
    room = FAR
    for i in range(SIGHT_POINTS):
        share = np.float32(i / (SIGHT_POINTS - 1))
        room = min(room, value_at(distance, x + share * (to_x - x), y + share * (to_y - y)))
    return bool(room >= sight)


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


def points_along(
    motions: Floats, ways: Floats, goal: Floats, *, handicap: Floats, reach: float
) -> Floats:
    """Return [3,P], points of motions [A,S,5] and of the straight lines from their ends to a goal.

    ways: [A,S] m; goal: [2] m; handicap: [A] m added to each; reach: m of way
    from the origin, up to which points count
    """
    beyond = np.linalg.norm(goal - motions[:, -1, :2], axis=1)
    longest = min(float((ways[:, -1] + beyond).max()), reach)
    count = int(min(MAX_POINTS, max(2.0, longest / SPACING)))
    points = np.empty((3, len(motions), count), np.float32)
    left = (ways[:, -1] + beyond + handicap).astype(np.float32)
    _sample(motions, ways, goal, left, np.float32(longest / (count - 1)), points)
    return points.reshape(3, -1)


@compiled
def _sample(
    motions: Floats, ways: Floats, goal: Floats, left: Floats, spacing: np.float32, points: Floats
) -> None:
    """Write points [3,A,C] at equal lengths of way; left: [A] m at the beginning of each."""
    last = motions.shape[1] - 1
    for k in range(len(motions)):
        s = int(nearest_sample(motions[k], NONE, NONE))
        first = ways[k, s]
        end_x, end_y, end = motions[k, last, 0], motions[k, last, 1], ways[k, last]
        by_x, by_y = goal[0] - end_x, goal[1] - end_y
        beyond = max(np.sqrt(by_x * by_x + by_y * by_y), np.float32(1e-6))
        for i in range(points.shape[2]):
            way = first + i * spacing
            while s < last and ways[k, s] < way:
                s += 1
            share = within((way - end) / beyond, NONE, ONE)
            done = min(max(ways[k, s], way), end + beyond)
            points[0, k, i] = motions[k, s, 0] + share * by_x
            points[1, k, i] = motions[k, s, 1] + share * by_y
            points[2, k, i] = left[k] - (done if s == last else ways[k, s])
