"""The map's cells as a graph, on which the length of a way round the obstacles is geodesic."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

FloatArray = NDArray[np.floating]


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
