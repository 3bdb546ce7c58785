"""Where a robot can go: the nearest place to a goal that its start is connected to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.routes.dijkstra import cell_index
from anchorflow_trajectory.routes.search import free_cells


def nearest_reachable(
    clearance: FloatArray,
    *,
    resolution: float,
    origin: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    within: float,
    slack: float,
) -> NDArray[np.float64] | None:
    """Return [2] m, the centre of the reachable cell nearest to the goal, or None.

    A cell is reachable if a route that keeps `slack` leads to it. Routes cut no corner, so that
    they connect the cells that steps to the four sides connect.

    Args:
        clearance: [H, W] m beyond robot_radius at cell centres.
        resolution: m/cell.
        origin: [2] m, outer corner of cell (0, 0).
        start, goal: [2] m.
        within: m from the goal at most.
        slack: m of clearance that the way and the place keep; less around the start.
    """
    first = cell_index(start, origin, resolution, clearance.shape)
    free = free_cells(clearance, [first], slack=slack)
    reached = connected(free, first) & (clearance >= slack)
    rows, columns = np.nonzero(reached)
    places = origin + resolution * (np.stack([columns, rows], -1) + 0.5)
    away = np.hypot(*(places - goal).T)
    if not len(away) or away.min() > within:
        return None
    return places[away.argmin()]


@compiled
def connected(free: BoolArray, first: int) -> BoolArray:
    """[H, W], the free cells that steps to the four sides lead to from a free flat cell."""
    height, width = free.shape
    reached, pending = np.zeros((height, width), np.bool_), [(first // width, first % width)]
    reached[pending[0]] = True
    while pending:
        row, column = pending.pop()
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            r, c = row + down, column + right
            if 0 <= r < height and 0 <= c < width and free[r, c] and not reached[r, c]:
                reached[r, c] = True
                pending.append((r, c))
    return reached


def cells_under(
    point: FloatArray,
    radius: float,
    *,
    resolution: float,
    origin: FloatArray,
    shape: tuple[int, int],
) -> BoolArray:
    """Return [H, W], the cells whose squares a disc about a point [2] m touches."""
    apart = []
    for along, count in zip((1, 0), shape, strict=True):
        low = origin[along] + resolution * np.arange(count)
        apart.append(np.maximum(np.maximum(low - point[along], point[along] - low - resolution), 0))
    under = np.hypot(apart[0][:, None], apart[1]) < radius
    under.flat[cell_index(point, origin, resolution, shape)] = True
    return under
