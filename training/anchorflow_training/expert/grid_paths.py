"""Alternative grid paths: each search pays extra for ground that earlier paths have used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.sparse.csgraph import dijkstra

from anchorflow_trajectory.geodesic import cell_index, grid_graph, traversal_cost

FloatArray = NDArray[np.floating]

PENALTY = 2.5  # extra cost a metre on ground that an earlier path has used
SPREAD = 0.045  # width of that ground, in shares of the map's side


def alternative_paths(
    clearance: FloatArray,
    resolution: float,
    origin: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    *,
    count: int,
    rng: np.random.Generator,
) -> list[FloatArray]:
    """Up to `count` polylines [P, 2] in m from start to goal, the cheapest first.

    clearance: [H, W] m. Ways through obstacles are dear, not forbidden; the descent decides.
    """
    base = traversal_cost(clearance)
    source, target = (cell_index(p, origin, resolution, base.shape) for p in (start, goal))
    extra, paths = np.zeros_like(base), []
    for _ in range(count):
        graph = grid_graph(base * (1.0 + extra), resolution)
        _, before = dijkstra(graph, directed=False, indices=source, return_predecessors=True)
        cells = [target]
        while cells[-1] != source:
            cells.append(before[cells[-1]])
        rows, columns = np.divmod(np.array(cells[::-1]), base.shape[1])
        inner = origin + (np.stack([columns, rows], -1)[1:-1] + 0.5) * resolution
        paths.append(np.concatenate([start[None], inner, goal[None]]).astype(np.float32))
        used = np.zeros_like(base)
        used[rows, columns] = 1.0
        used = gaussian_filter(used, SPREAD * max(base.shape))
        extra += used / used.max() * PENALTY * rng.uniform(0.5, 1.5)
    return paths
