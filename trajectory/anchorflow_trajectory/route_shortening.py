"""Routes pulled tight: the grid's corners cut wherever the straight way is as clear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.ray_signature import ObstacleRays
from anchorflow_trajectory.routes import Route, polyline_length

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

# m of clearance that a chord keeps: more than the search asks, a spline needs room for its bends.
CHORD_SLACK = 0.1
STRIDE = 4  # cells at most between points of a straight piece that chords may end at
SAME_LEG = 1e-6  # of a leg, by which the next may differ where the way does not turn
LOOKS_A_CELL = 2.0  # points of a chord at which clearance is looked up


def pulled_tight(
    routes: Sequence[Route],
    clearance: FloatArray,
    *,
    resolution: float,
    origin: FloatArray,
    slack: float = CHORD_SLACK,
    rays: ObstacleRays | None = None,
) -> list[Route]:
    """The same routes along fewer points, no longer than before, the shortest first.

    A path of steps to eight neighbours is up to 8 % longer than the way that it stands for. From
    each corner the furthest is taken to which the chord is clear and passes the obstacles on the
    same sides as the route does.

    Args:
        routes: as `find_routes` finds them on this map.
        clearance: [H, W] m beyond robot_radius at cell centres.
        resolution: m/cell.
        origin: [2] m, outer corner of cell (0, 0).
        slack: m of clearance that a chord keeps at every cell that it crosses.
        rays: of this clearance, where they are known already.
    """
    free, rays, tight = clearance >= slack, rays or ObstacleRays.of(clearance), []
    for route in routes:
        corners = route.points[_corners(route.points)]
        crossed = rays.crossings(corners, resolution=resolution, origin=origin)
        before = np.concatenate([np.zeros((1, crossed.shape[1]), int), np.cumsum(crossed, axis=0)])
        at, kept = 0, [0]
        while at < len(corners) - 1:
            chords = np.stack(np.broadcast_arrays(corners[at], corners[at + 1 :]), axis=1)
            around = rays.crossings(chords, resolution=resolution, origin=origin)[:, 0]
            good = (around == before[at + 1 :] - before[at]).all(1)
            good &= _clear(chords, free, resolution, origin)
            good[0] = True  # a straight piece of the route itself
            at += 1 + int(np.flatnonzero(good)[-1])
            kept.append(at)
        points = corners[kept]
        tight.append(Route(points, polyline_length(points), route.signature))
    return sorted(tight, key=lambda route: route.length)


def _corners(points: FloatArray) -> NDArray[np.intp]:
    """The places of both ends, of the points [K, 2] at which the way turns, and of some between."""
    legs = np.diff(points, axis=0)
    turns = np.abs(np.diff(legs, axis=0)).max(1) > SAME_LEG * np.abs(legs).max()
    turns[STRIDE - 1 :: STRIDE] = True
    return np.concatenate([[0], np.flatnonzero(turns) + 1, [len(points) - 1]])


def _clear(chords: FloatArray, free: BoolArray, resolution: float, origin: FloatArray) -> BoolArray:
    """Whether all cells on straight ways [M, 2, 2] in m are free: [M]."""
    cells = (chords - origin) / resolution
    longest = float(np.abs(cells[:, 1] - cells[:, 0]).max())
    share = np.linspace(0.0, 1.0, int(longest * LOOKS_A_CELL) + 2)[:, None, None]
    x, y = np.moveaxis(cells[:, 0] + share * (cells[:, 1] - cells[:, 0]), -1, 0)
    height, width = free.shape
    rows, columns = (np.clip(v.astype(int), 0, n - 1) for v, n in ((y, height), (x, width)))
    return np.asarray(free[rows, columns].all(0))
