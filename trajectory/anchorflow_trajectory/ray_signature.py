"""Which way round the obstacles a path goes, told by the rays that it crosses.

Each obstacle that can be gone round sends a ray towards +y. A path's signature counts its crossings
of every ray, from left to right less from right to left. Paths with common ends and one signature
are homologous (Bhattacharya, Likhachev & Kumar, "Topological constraints in search-based robot path
planning", Autonomous Robots 33, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

FloatArray = NDArray[np.floating]
Signature = tuple[int, ...]

EIGHT_NEIGHBOURS = np.ones((3, 3))
KEYS_SEED = 0


@dataclass(frozen=True, eq=False)
class ObstacleRays:
    """The rays of a map's K obstacles.

    columns, rows: [K] a cell of each obstacle, its first by row and then by column; the ray leaves
        the cell's right edge at half its height. Obstacles are in the order of these cells.
    shape: (H, W) of the map
    """

    columns: NDArray[np.intp]
    rows: NDArray[np.intp]
    shape: tuple[int, int]

    @staticmethod
    def of(clearance: FloatArray) -> ObstacleRays:
        """Of a map's clearance [H, W] in m beyond robot_radius.

        An obstacle is a connected part of the ground where it is negative. Those that touch the
        map's edge have no ray: nothing passes behind them.
        """
        labels = np.asarray(label(clearance < 0.0, EIGHT_NEIGHBOURS)[0])  # type: ignore[index]
        numbers, first = np.unique(labels, return_index=True)
        edges = (labels[0], labels[-1], labels[:, 0], labels[:, -1])
        inner = ~np.isin(numbers, np.concatenate([[0], *edges]))
        rows, columns = np.divmod(first[inner], clearance.shape[1])
        return ObstacleRays(columns, rows, (clearance.shape[0], clearance.shape[1]))

    def keys_crossed(self) -> NDArray[np.uint64]:
        """[H, W]: what a step from each cell to the column on its right adds to a signature's key.

        A key is the sum, modulo 2^64, of a number drawn for each obstacle times its crossings: one
        integer that stands for the whole signature while many are compared.
        """
        keys = np.random.default_rng(KEYS_SEED).integers(
            0, 2**64 - 1, len(self.rows), np.uint64, endpoint=True
        )
        starts = np.zeros((self.shape[0] + 1, self.shape[1]), np.uint64)
        np.add.at(starts, (self.rows + 1, self.columns), keys)
        return np.cumsum(starts, axis=0, dtype=np.uint64)[:-1]

    def crossings(
        self, points: FloatArray, *, resolution: float, origin: FloatArray
    ) -> NDArray[np.int64]:
        """Signed crossings [..., T - 1, K] of each leg of polylines [..., T, 2] in m."""
        cells = (np.asarray(points, np.float64) - origin) / resolution
        x, y = cells[..., None, 0], cells[..., None, 1]
        right = (x > self.columns + 1.0).astype(np.int64)
        step = np.diff(right, axis=-2)
        run = np.where(step == 0, 1.0, np.diff(x, axis=-2))
        share = (self.columns + 1.0 - x[..., :-1, :]) / run
        above = y[..., :-1, :] + share * np.diff(y, axis=-2) > self.rows + 0.5
        return step * above

    def signatures(
        self, paths: FloatArray, *, resolution: float, origin: FloatArray
    ) -> list[Signature]:
        """A signature for each of the polylines [N, T, 2] in m of the map's frame."""
        crossings = self.crossings(paths, resolution=resolution, origin=origin).sum(-2)
        return [tuple(row) for row in crossings.tolist()]
