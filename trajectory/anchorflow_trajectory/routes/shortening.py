"""Routes pulled tight: the grid's corners cut wherever the straight way is as clear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.routes.homotopy import ObstacleRays, crossings, in_cells
from anchorflow_trajectory.routes.search import (
    LOOKS_A_CELL,
    Route,
    charge_along,
    charge_of_leg,
    polyline_length,
)

Points = NDArray[np.float64]
Cells = NDArray[np.int64]

# m of clearance that a chord keeps: more than the search asks, a spline needs room for its bends.
CHORD_SLACK = 0.1
STRIDE = 4  # cells at most between points of a straight piece that chords may end at
SAME_LEG = 1e-6  # of a leg, by which the next may differ where the way does not turn


def pulled_tight(
    routes: Sequence[Route],
    clearance: FloatArray,
    *,
    resolution: float,
    origin: FloatArray,
    slack: float = CHORD_SLACK,
    rays: ObstacleRays | None = None,
    surcharge: FloatArray | None = None,
) -> list[Route]:
    """The same routes along fewer points, no dearer than before, the cheapest first.

    A path of steps to eight neighbours is up to 8 % longer than the straight way. From each corner
    the path jumps to the furthest point whose chord is clear and passes the obstacles on the same
    sides. With a surcharge it takes the chords that cost least in sum.

    Args:
        routes: as `find_routes` finds them on this map.
        clearance: [H, W] m beyond robot_radius at cell centres.
        resolution: m/cell.
        origin: [2] m, outer corner of cell (0, 0).
        slack: m of clearance that a chord keeps at every cell that it crosses.
        rays: of this clearance, if they are already known.
        surcharge: [H, W], with which the routes were found.
    """
    free, rays, tight = clearance >= slack, rays or ObstacleRays.of(clearance, surcharge), []
    dear = None if surcharge is None else surcharge.astype(np.float64)
    for route in routes:
        cells, corners = in_cells(route.points, resolution, origin), _corners(route.points)
        if dear is None:
            kept = _kept(cells, corners, free, rays.columns, rays.rows)
        else:
            kept = _cheapest(cells, corners, free, dear, rays.columns, rays.rows)
        points = route.points[kept]
        length = polyline_length(points)
        charge = 0.0 if dear is None else resolution * charge_along(cells[kept], dear)
        tight.append(Route(points, length, route.signature, charge))
    return sorted(tight, key=lambda route: route.cost)


@compiled
def _corners(points: Points) -> Cells:
    """The places of both ends, of the points [K, 2] at which the way turns, and of some between."""
    legs = points[1:] - points[:-1]
    longest = np.abs(legs).max()
    corners, count = np.zeros(len(points), np.int64), 1
    for k in range(1, len(legs)):
        turn = np.abs(legs[k] - legs[k - 1]).max()
        if turn > SAME_LEG * longest or k % STRIDE == 0:
            corners[count] = k
            count += 1
    corners[count] = len(legs)
    return corners[: count + 1]


@compiled
def _kept(
    points: Points,
    corners: Cells,
    free: BoolArray,
    columns: Cells,
    rows: Cells,
) -> Cells:
    """The corners that are left of a route's points [K, 2] in cells, where chords cut the others.

    free: [H, W] cells that chords may cross; columns, rows: of the obstacles' rays
    """
    kept, count, at = np.zeros(len(corners), np.int64), 1, 0
    while at < len(corners) - 1:
        begin, to = points[corners[at]], at + 1
        reach = 0.0
        for later in range(at + 1, len(corners)):
            reach = max(reach, np.abs(points[corners[later]] - begin).max())
        # As many of every chord from here as the longest needs.
        looks = int(reach * LOOKS_A_CELL) + 2
        for later in range(len(corners) - 1, at + 1, -1):
            end = points[corners[later]]
            if _is_clear(begin, end, free, looks) and _same_sides(
                points[corners[at : later + 1]], columns, rows
            ):
                to = later
                break
        at = to
        kept[count] = corners[at]
        count += 1
    return kept[:count]


@compiled
def _cheapest(
    points: Points,
    corners: Cells,
    free: BoolArray,
    surcharge: Points,
    columns: Cells,
    rows: Cells,
) -> Cells:
    """The corners between which chords cost least in sum, of a route's points [K, 2] in cells.

    free: [H, W] cells that chords may cross; surcharge: [H, W] of them
    columns, rows: of the obstacles' rays
    """
    count = len(corners)
    crossed = np.zeros((count, len(columns)), np.int64)  # rays, by the way up to each corner
    least, came = np.full(count, np.inf), np.zeros(count, np.int64)
    least[0] = 0.0
    for to in range(1, count):
        part = points[corners[to - 1] : corners[to] + 1]
        for k in range(len(columns)):
            crossed[to, k] = crossed[to - 1, k] + crossings(part, columns[k], rows[k])
        for at in range(to):
            begin, end = points[corners[at]], points[corners[to]]
            far = np.sqrt(((end - begin) ** 2).sum())
            if least[at] + far >= least[to]:
                continue
            # The way itself is clear where a chord from corner to corner need not be.
            if at < to - 1 and not _is_clear(
                begin, end, free, int(LOOKS_A_CELL * np.abs(end - begin).max()) + 2
            ):
                continue
            cost = least[at] + far + charge_of_leg(begin, end, surcharge)
            if cost >= least[to] or not _same_crossings(
                points, corners, at, to, crossed, columns, rows
            ):
                continue
            least[to], came[to] = cost, at
    kept, found, at = np.zeros(count, np.int64), 0, count - 1
    while at:
        kept[found] = corners[at]
        found += 1
        at = came[at]
    return kept[: found + 1][::-1].copy()


@compiled_part
def _same_crossings(
    points: Points, corners: Cells, at: int, to: int, crossed: Cells, columns: Cells, rows: Cells
) -> bool:
    """Whether the chord between two corners crosses every ray as often as the way [corners, K]."""
    chord = np.stack((points[corners[at]], points[corners[to]]))
    for k in range(len(columns)):
        if crossings(chord, columns[k], rows[k]) != crossed[to, k] - crossed[at, k]:
            return False
    return True


@compiled_part
def _is_clear(begin: Points, end: Points, free: BoolArray, looks: int) -> bool:
    """Whether the cells at `looks` points of the straight line [2] to [2] are free."""
    height, width = free.shape
    apart = 1.0 / (looks - 1)
    for look in range(looks):
        share = look * apart
        column = int(begin[0] + share * (end[0] - begin[0]))
        row = int(begin[1] + share * (end[1] - begin[1]))
        if not free[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]:
            return False
    return True


@compiled_part
def _same_sides(points: Points, columns: Cells, rows: Cells) -> bool:
    """Whether the chord between both ends of a polyline [K, 2] crosses every ray as often."""
    chord = np.stack((points[0], points[-1]))
    for k in range(len(columns)):
        if crossings(points, columns[k], rows[k]) != crossings(chord, columns[k], rows[k]):
            return False
    return True
