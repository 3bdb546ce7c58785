"""Find the length of the shortest path on a grid, the reference for path lengths."""

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


def shortest_grid_path(passable: NDArray[np.bool_], start: Cell, goal: Cell) -> float:
    """Return the length in cells of the shortest path over passable cells [H, W]; NaN without one.

    The start cell need not be passable, and a move of two cells only checks its end.
    """
    passable = passable.copy()
    passable[start] = True
    numbers = np.arange(passable.size, dtype=np.int32).reshape(passable.shape)
    tails, heads, steps = [], [], []
    for move in MOVES:
        here, there = (_shifted(numbers, move, sign) for sign in (1, -1))
        open_move = _shifted(passable, move, 1) & _shifted(passable, move, -1)
        tails.append(here[open_move])
        heads.append(there[open_move])
        steps.append(np.full(len(tails[-1]), np.hypot(*move)))
    edges = (np.concatenate(tails), np.concatenate(heads))
    graph = csr_array((np.concatenate(steps), edges), shape=(passable.size,) * 2)
    lengths = dijkstra(graph, directed=False, indices=numbers[start])
    length = float(lengths[numbers[goal]])
    return length if np.isfinite(length) else np.nan


def shortest_way(scene: Scene) -> float:
    """Return the m of the shortest grid path that keeps robot_radius; NaN without one."""
    occupied, ends = scene.occupied, (scene.x_curr[:2], scene.x_goal[:2])
    cells = [((end - scene.origin) / scene.resolution).astype(int)[::-1] for end in ends]
    if occupied.any():
        passable = np.asarray(distance_transform_edt(~occupied)) * scene.resolution
        passable = passable > scene.robot_radius
    else:
        passable = np.ones(occupied.shape, bool)
    start, goal = (np.clip(cell, 0, np.array(passable.shape) - 1) for cell in cells)
    return shortest_grid_path(passable, tuple(start), tuple(goal)) * scene.resolution


def _shifted(grid: NDArray, move: Cell, sign: int) -> NDArray:
    """Return the cells from which (sign 1) or to which (sign -1) a move stays on the grid."""
    height, width = grid.shape
    rows, columns = move if sign > 0 else (-move[0], -move[1])
    return grid[
        max(0, -rows) : min(height, height - rows),
        max(0, -columns) : min(width, width - columns),
    ]
