"""The shortest routes of a scene, one for each way round its obstacles.

A route is the shortest path on the grid among those with its signature (`ray_signature`). How they
are searched stands in `route_search`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.grid import cell_index, free_steps
from anchorflow_trajectory.ray_signature import ObstacleRays, Signature
from anchorflow_trajectory.route_search import search_routes

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

MOST_ROUTES = 12
STRETCH = 1.3
SLACK = 0.02  # m beyond robot_radius that a route keeps, so that a spline along it can


@dataclass(frozen=True, eq=False)
class Route:
    """A way from start to goal.

    points: [K, 2] m, in the map's frame, from the start to the goal
    length: m, of the polyline through them
    signature: crossings of the ray of each obstacle, as `ObstacleRays` orders them
    """

    points: NDArray[np.float64]
    length: float
    signature: Signature


def find_routes(
    clearance: FloatArray,
    *,
    resolution: float,
    origin: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    most: int = MOST_ROUTES,
    stretch: float = STRETCH,
    slack: float = SLACK,
    rays: ObstacleRays | None = None,
) -> list[Route]:
    """The shortest routes on the grid with different signatures, the shortest first.

    Empty where no way is free. The same arguments bring the same routes.

    Args:
        clearance: [H, W] m beyond robot_radius at cell centres, negative where the robot would
            touch something.
        resolution: m/cell.
        origin: [2] m, outer corner of cell (0, 0).
        start, goal: [2] m. Cells about them are free with less than `slack`, their own with any
            clearance: who stands close to something may leave.
        most: routes at most.
        stretch: times the shortest that a route may be long.
        slack: m of clearance that routes keep.
        rays: of this clearance, where they are known already.

    Raises:
        ValueError: `most` is below 1, `stretch` below 1 or `slack` negative.
    """
    if most < 1 or not stretch >= 1.0 or not slack >= 0.0:
        raise ValueError(
            f"expected most >= 1, stretch >= 1 and slack >= 0, got {most}, {stretch} and {slack}"
        )
    height, width = clearance.shape
    ends = [cell_index(end, origin, resolution, (height, width)) for end in (start, goal)]
    free = free_cells(clearance, ends, slack=slack)
    rays, routes = rays or ObstacleRays.of(clearance), []
    crossed, (first, last) = rays.keys_crossed().ravel(), ends
    cells, parts = search_routes(
        free_steps(free), width, crossed, first, last, most, float(stretch)
    )
    at = (np.stack([cells % width, cells // width], -1) + 0.5) * resolution + origin
    for begin, end in pairwise(parts.tolist()):
        points = np.concatenate([[start], at[begin + 1 : end - 1], [goal]]).astype(np.float64)
        (signature,) = rays.signatures(points[None], resolution=resolution, origin=origin)
        routes.append(Route(points, polyline_length(points), signature))
    return sorted(routes, key=lambda route: route.length)


def polyline_length(points: FloatArray) -> float:
    """m, through points [K, 2]."""
    legs = points[1:] - points[:-1]
    return float(np.sqrt((legs * legs).sum(1)).sum())


def free_cells(clearance: FloatArray, ends: Sequence[int], *, slack: float) -> BoolArray:
    """[H, W], the cells that routes may take between two flat cells."""
    free = clearance >= slack
    for row, column in (divmod(end, clearance.shape[1]) for end in ends):
        about = (slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2))
        free[about] |= clearance[about] >= 0.0
        free[row, column] = True
    return free
