"""Geodesic distances on the map: how long the way round the obstacles is."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

FloatArray = NDArray[np.floating]

MAX_CELLS = 64  # a side; a finer map is pooled to this, the network needs no more
BLOCKED_COST = 30.0  # a metre through an obstacle costs as much as this many metres of free way
TIGHT_COST = 6.0  # a metre at zero clearance, relative to one in the open
COMFORT = 0.25  # m, clearance from which a cell costs no more than its length


def pool(
    clearance: FloatArray, resolution: float, *, max_cells: int = MAX_CELLS
) -> tuple[FloatArray, float]:
    """The best clearance of each block of cells, and the block's size in m.

    Optimistic on purpose: a gap that the fine map shows must not close on the coarse one.
    """
    factor = -(-max(clearance.shape) // max_cells)
    height, width = (-(-n // factor) * factor for n in clearance.shape)
    padding = ((0, height - clearance.shape[0]), (0, width - clearance.shape[1]))
    padded = np.pad(clearance, padding, mode="edge")
    blocks = padded.reshape(height // factor, factor, width // factor, factor)
    return blocks.max(axis=(1, 3)), resolution * factor


def traversal_cost(clearance: FloatArray) -> FloatArray:
    """Cost of a metre through each cell, at least 1: [H, W]."""
    tight = 1.0 + (TIGHT_COST - 1.0) * np.clip(1.0 - clearance / COMFORT, 0.0, 1.0)
    return np.where(clearance < 0, BLOCKED_COST, tight)


@lru_cache(maxsize=16)
def _edges(height: int, width: int) -> tuple[NDArray[np.int32], NDArray[np.int32], FloatArray]:
    """Pairs of neighbouring cells (8-connected, each once) and their distance in cells."""
    cells = np.arange(height * width, dtype=np.int32).reshape(height, width)
    pairs = [
        (cells[:, :-1], cells[:, 1:], 1.0),
        (cells[:-1], cells[1:], 1.0),
        (cells[:-1, :-1], cells[1:, 1:], np.sqrt(2.0)),
        (cells[:-1, 1:], cells[1:, :-1], np.sqrt(2.0)),
    ]
    tails = np.concatenate([a.ravel() for a, _, _ in pairs])
    heads = np.concatenate([b.ravel() for _, b, _ in pairs])
    steps = np.concatenate([np.full(a.size, c, np.float32) for a, _, c in pairs])
    return tails, heads, steps


def grid_graph(cost: FloatArray, cell_size: float) -> csr_array:
    """Undirected graph of the cells; an edge weighs its length [m] times its ends' mean cost."""
    tails, heads, steps = _edges(*cost.shape)
    flat = cost.ravel()
    weights = steps * cell_size * 0.5 * (flat[tails] + flat[heads])
    return csr_array((weights, (tails, heads)), shape=(flat.size, flat.size))


def cell_index(
    point: FloatArray, origin: FloatArray, cell_size: float, shape: tuple[int, int]
) -> int:
    """Flat index of the cell that holds a point [2] in m, clamped to the map."""
    column, row = ((np.asarray(point[:2]) - origin) / cell_size).astype(int)
    return int(np.clip(row, 0, shape[0] - 1) * shape[1] + np.clip(column, 0, shape[1] - 1))


def cost_to_go(
    clearance: FloatArray,
    resolution: float,
    origin: FloatArray,
    start: FloatArray,
    goal: FloatArray,
) -> FloatArray:
    """Geodesic cost [m] from the start and to the goal at every cell; [2, H, W].

    Lengths are weighted by `traversal_cost`: a way through an obstacle is long, never infinite.
    """
    coarse, cell_size = pool(clearance, resolution)
    graph = grid_graph(traversal_cost(coarse), cell_size)
    ends = [cell_index(point, origin, cell_size, coarse.shape) for point in (start, goal)]
    costs = dijkstra(graph, directed=False, indices=ends).reshape(2, *coarse.shape)
    factor = round(cell_size / resolution)
    height, width = clearance.shape
    fine = costs.astype(np.float32).repeat(factor, axis=1).repeat(factor, axis=2)
    return np.ascontiguousarray(fine[:, :height, :width])
