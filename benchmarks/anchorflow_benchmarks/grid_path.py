"""Find the shortest and the cheapest path on a grid, the references for lengths and soft costs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from anchorflow_trajectory.scene import Scene

Cell = tuple[int, int]

REACH = 2  # cells per move and axis: with 24 neighbours lengths are nearly Euclidean
MOVES = [(0, 1), (0, 2)] + [
    (rows, columns) for rows in (1, 2) for columns in range(-REACH, REACH + 1)
]


def grid_path(
    passable: NDArray[np.bool_],
    start: Cell,
    goal: Cell,
    surcharge: NDArray[np.floating] | None = None,
) -> tuple[float, NDArray[np.intp]]:
    """Return the cheapest path over passable cells [H, W]: its cost in cells, and its cells [K, 2].

    A move costs its length times one plus the mean surcharge of its ends. Without a path the cost
    is NaN. The start cell need not be passable, and a move of two cells only checks its end.
    """
    lengths, before = _shortest_paths(passable, start, surcharge)
    numbers = np.arange(passable.size).reshape(passable.shape)
    way = [int(numbers[goal])]
    if not np.isfinite(lengths[way[0]]):
        return np.nan, np.empty((0, 2), np.intp)
    while way[-1] != numbers[start]:
        way.append(int(before[way[-1]]))
    return float(lengths[way[0]]), np.stack(np.divmod(way[::-1], passable.shape[1]), -1)


def distances_from(passable: NDArray[np.bool_], start: Cell) -> NDArray[np.float64]:
    """Return the length in cells [H, W] of the shortest path from a cell; inf without one."""
    return _shortest_paths(passable, start, None)[0].reshape(passable.shape)


def _shortest_paths(
    passable: NDArray[np.bool_], start: Cell, surcharge: NDArray[np.floating] | None
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the cost [H * W] of every cell's cheapest path, and the cell before it."""
    passable = passable.copy()
    passable[start] = True
    numbers = np.arange(passable.size, dtype=np.int32).reshape(passable.shape)
    price = np.ones(passable.size) if surcharge is None else 1.0 + surcharge.ravel()
    tails, heads, costs = [], [], []
    for move in MOVES:
        here, there = (_shifted(numbers, move, sign) for sign in (1, -1))
        open_move = _shifted(passable, move, 1) & _shifted(passable, move, -1)
        tails.append(here[open_move])
        heads.append(there[open_move])
        costs.append(np.hypot(*move) * 0.5 * (price[tails[-1]] + price[heads[-1]]))
    edges = (np.concatenate(tails), np.concatenate(heads))
    graph = csr_array((np.concatenate(costs), edges), shape=(passable.size,) * 2)
    return dijkstra(graph, directed=False, indices=numbers[start], return_predecessors=True)


def shortest_way(scene: Scene) -> float:
    """Return the m of the shortest grid path that keeps robot_radius; NaN without one."""
    return _way(scene, None)[0] * scene.resolution


def cheapest_way(scene: Scene) -> NDArray[np.float64]:
    """Return the points [K, 2] of the cheapest grid path that keeps robot_radius; K = 0 without."""
    cells = _way(scene, scene.surcharge)[1]
    return scene.origin + (cells[:, ::-1] + 0.5) * scene.resolution


def _way(scene: Scene, surcharge: NDArray[np.floating] | None) -> tuple[float, NDArray[np.intp]]:
    occupied, ends = scene.occupied, (scene.x_curr[:2], scene.x_goal[:2])
    cells = [((end - scene.origin) / scene.resolution).astype(int)[::-1] for end in ends]
    if occupied.any():
        passable = np.asarray(distance_transform_edt(~occupied)) * scene.resolution
        passable = passable > scene.robot_radius
    else:
        passable = np.ones(occupied.shape, bool)
    start, goal = (np.clip(cell, 0, np.array(passable.shape) - 1) for cell in cells)
    return grid_path(passable, tuple(start), tuple(goal), surcharge)


def _shifted(grid: NDArray, move: Cell, sign: int) -> NDArray:
    """Return the cells from which (sign 1) or to which (sign -1) a move stays on the grid."""
    height, width = grid.shape
    rows, columns = move if sign > 0 else (-move[0], -move[1])
    return grid[
        max(0, -rows) : min(height, height - rows),
        max(0, -columns) : min(width, width - columns),
    ]
