"""Which way round the obstacles a path goes, told by the rays that it crosses.

Each obstacle that can be gone round sends a ray towards +y, and so does each dear patch. A path's
signature counts its crossings of every ray, from left to right less from right to left. Paths with
common ends and one signature are homologous (Bhattacharya, Likhachev & Kumar, "Topological
constraints in search-based robot path planning", Autonomous Robots 33, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.routes.dijkstra import STEPS

Signature = tuple[int, ...]

KEYS_SEED = 0
DEAR = 0.5  # surcharge from which on ground is part of a dear patch


@dataclass(frozen=True, eq=False)
class ObstacleRays:
    """The rays of a map's K obstacles.

    columns, rows: [K] a cell of each obstacle, its first by row and then by column; the ray leaves
        the cell's right edge at half its height. Obstacles are in the order of these cells, and
        dear patches, each with the cell nearest to its mean, come after them.
    shape: (H, W) of the map
    obstacles: how many of the K are obstacles
    """

    columns: NDArray[np.intp]
    rows: NDArray[np.intp]
    shape: tuple[int, int]
    obstacles: int

    @staticmethod
    def of(clearance: FloatArray, surcharge: FloatArray | None = None) -> ObstacleRays:
        """Of a map's clearance [H, W] in m beyond robot_radius, and of its surcharge [H, W].

        An obstacle is a connected part of the ground where clearance is negative, a dear patch one
        where the surcharge is DEAR or more. Those that touch the map's edge have no ray, because
        nothing passes behind them; nor has a patch that touches an obstacle.
        """
        blocked = clearance < 0.0
        cells = _inner_parts(blocked, np.zeros_like(blocked), False)
        obstacles = len(cells)
        if surcharge is not None:
            patches = _inner_parts(~blocked & (surcharge >= DEAR), blocked, True)
            cells = np.concatenate((cells, patches))
        rows, columns = np.divmod(cells, clearance.shape[1])
        return ObstacleRays(columns, rows, (clearance.shape[0], clearance.shape[1]), obstacles)

    def keys_crossed(self) -> NDArray[np.uint64]:
        """[H, W]: what a step from each cell to the column on its right adds to a signature's key.

        A key is the sum, modulo 2^64, of a number drawn for each obstacle times its crossings: one
        integer that stands for the whole signature while many are compared.
        """
        return _crossed(_keys(len(self.rows)), self.columns, self.rows, *self.shape)

    def is_simple(self, signature: Signature, start: FloatArray, goal: FloatArray) -> bool:
        """Whether a path from start to goal, [2] in cells, winds round no dear patch.

        Nothing keeps a path from turning a loop on ground that is dear but passable.
        """
        edges = self.columns[self.obstacles :] + 1.0
        along = (goal[0] > edges).astype(int) - (start[0] > edges)
        crossed = np.array(signature[self.obstacles :], int)
        return bool(
            np.where(along == 0, np.abs(crossed) <= 1, crossed * (crossed - along) == 0).all()
        )

    def signatures(
        self, paths: FloatArray, *, resolution: float, origin: FloatArray
    ) -> list[Signature]:
        """A signature for each of the polylines [N, T, 2] in m of the map's frame."""
        cells = in_cells(paths, resolution, origin)
        summed = _summed_crossings(cells, self.columns, self.rows)
        return [tuple(row) for row in summed.tolist()]


@lru_cache(maxsize=64)
def _keys(count: int) -> NDArray[np.uint64]:
    return np.random.default_rng(KEYS_SEED).integers(0, 2**64 - 1, count, np.uint64, endpoint=True)


def in_cells(points: FloatArray, resolution: float, origin: FloatArray) -> NDArray[np.float64]:
    """Points [..., 2] in cells from the map's corner."""
    return np.ascontiguousarray((np.asarray(points, np.float64) - origin) / resolution)


@compiled
def _inner_parts(
    cells: NDArray[np.bool_], barred: NDArray[np.bool_], is_middle: bool
) -> NDArray[np.int64]:
    """[K], a flat cell of each connected part of a grid [H, W] that touches no edge.

    It is the part's first cell, or with `is_middle` the one nearest to its mean. Nor does a part
    touch a barred cell. Cells that touch in a corner are connected.
    """
    height, width = cells.shape
    seen, members = np.zeros(cells.shape, np.bool_), np.empty(cells.size, np.int64)
    found = np.empty(cells.size, np.int64)
    count = 0
    for begin in range(cells.size):
        if seen.flat[begin] or not cells.flat[begin]:
            continue
        seen.flat[begin], members[0], done, size, is_inner = True, begin, 0, 1, True
        while done < size:
            row, column = divmod(members[done], width)
            done += 1
            is_inner &= 0 < row < height - 1 and 0 < column < width - 1
            for k in range(len(STEPS)):
                to_row, to_column = row + STEPS[k, 0], column + STEPS[k, 1]
                if not (0 <= to_row < height and 0 <= to_column < width):
                    continue
                is_inner &= not barred[to_row, to_column]
                if cells[to_row, to_column] and not seen[to_row, to_column]:
                    seen[to_row, to_column] = True
                    members[size] = to_row * width + to_column
                    size += 1
        if is_inner:
            found[count] = begin
            if is_middle:
                rows, columns = members[:size] // width, members[:size] % width
                away = (rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2
                found[count] = members[np.argmin(away)]
            count += 1
    return found[:count].copy()


@compiled
def _crossed(
    keys: NDArray[np.uint64],
    columns: NDArray[np.int64],
    rows: NDArray[np.int64],
    height: int,
    width: int,
) -> NDArray[np.uint64]:
    """The sums [H, W] of the keys [K] whose rays a step to the right crosses."""
    crossed = np.zeros((height, width), np.uint64)
    for k in range(len(keys)):
        for row in range(rows[k] + 1, height):
            crossed[row, columns[k]] += keys[k]
    return crossed


@compiled
def _summed_crossings(
    paths: NDArray[np.float64], columns: NDArray[np.int64], rows: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Signed crossings [N, K] of K rays by polylines [N, T, 2] in cells."""
    summed = np.zeros((len(paths), len(columns)), np.int64)
    for n in range(len(paths)):
        for k in range(len(columns)):
            summed[n, k] = crossings(paths[n], columns[k], rows[k])
    return summed


@compiled_part
def crossings(path: NDArray[np.float64], column: int, row: int) -> int:
    """Crossings of a ray by a polyline [T, 2] in cells: to the right, less those to the left."""
    edge, found = column + 1.0, 0
    for leg in range(len(path) - 1):
        x, to_x = path[leg, 0], path[leg + 1, 0]
        if (x > edge) == (to_x > edge):
            continue
        y, to_y = path[leg, 1], path[leg + 1, 1]
        if y + (edge - x) / (to_x - x) * (to_y - y) > row + 0.5:
            found += 1 if to_x > edge else -1
    return found
