"""Routes of an answer: which anchors pass the obstacles on the same sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OCCUPIED, AnchorBatch, CostMap

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

BLOCK = 0.1  # m: obstacles nearer to each other than that count as one
FAR = 0.5  # m, mean distance from which on a path is on none of the routes


@dataclass(frozen=True, eq=False)
class Routes:
    """What tells the anchors of one answer apart.

    points: [M, 2] m, at least one in each obstacle
    paths: [N, T, 2] m; of: [N], the route of each, numbered from 0
    signatures: [R, M] of the routes
    """

    points: Array
    paths: Array
    of: NDArray[np.intp]
    signatures: NDArray[np.int8]

    @classmethod
    def among(cls, batch: AnchorBatch, cost_map: CostMap) -> Routes:
        """Of the anchors of one scene, on the map [C,H,W] that they were asked for."""
        points = landmarks(cost_map)
        paths = batch.trajectories[..., :2].astype(np.float64)
        found, of = np.unique(signatures(paths, points), axis=0, return_inverse=True)
        return cls(points, paths, of.reshape(-1), found)

    def route_of(self, path: Array) -> int | None:
        """The route that a path [K, 2] in m takes, which may begin and end a little elsewhere.

        The one with its signature or, where none has that, the one of the nearest anchor; None
        where that is further than FAR away in the mean.
        """
        joined = np.concatenate([self.paths[0, :1], path, self.paths[0, -1:]])
        same = (self.signatures == signatures(joined[None], self.points)).all(1)
        if same.any():
            return int(same.argmax())
        length = min(_lengths(path[None])[0, -1], _lengths(self.paths)[:, -1].min())
        at = np.linspace(0.0, length, len(path))
        own, others = _along(path, at), np.stack([_along(each, at) for each in self.paths])
        apart = np.linalg.norm(others - own, axis=-1).mean(1)
        nearest = int(apart.argmin())
        return int(self.of[nearest]) if apart[nearest] <= FAR else None


def landmarks(cost_map: CostMap) -> Array:
    """[M, 2] m, the lower left corners of the obstacles: every obstacle has one at least."""
    side = max(1, round(BLOCK / cost_map.resolution))
    occupied = cost_map.occupancy >= OCCUPIED
    rows, columns = (-(-size // side) for size in occupied.shape)
    padded = np.zeros((rows * side, columns * side), np.bool_)
    padded[: occupied.shape[0], : occupied.shape[1]] = occupied
    blocks = padded.reshape(rows, side, columns, side).any((1, 3))
    edged = np.pad(blocks, 1)
    corners = blocks & ~edged[1:-1, :-2] & ~edged[:-2, 1:-1] & ~edged[:-2, :-2]
    row, column = np.nonzero(corners)
    return cost_map.origin + side * cost_map.resolution * (np.stack([column, row], 1) + 0.5)


def signatures(paths: Array, points: Array) -> NDArray[np.int8]:
    """[N, M]: how often each path [N, T, 2] crosses the ray that goes up from each point [M, 2].

    From left to right counts 1, from right to left -1. Of two paths with the same ends, one can be
    bent into the other past the points where all these numbers are the same.
    """
    left, right = paths[:, :-1, None], paths[:, 1:, None]
    x, y = points.T
    crossing = (left[..., 0] <= x).astype(np.int8) - (right[..., 0] <= x)
    n, t, m = np.nonzero(crossing)
    a, b = paths[n, t], paths[n, t + 1]
    height = a[:, 1] + (x[m] - a[:, 0]) * (b[:, 1] - a[:, 1]) / (b[:, 0] - a[:, 0])
    counts = np.zeros((len(paths), len(points)), np.int8)
    np.add.at(counts, (n, m), crossing[n, t, m] * (height > y[m]))
    return counts


def _lengths(paths: Array) -> Array:
    """[N, T] m from the beginning of paths [N, T, 2]."""
    steps = np.linalg.norm(np.diff(paths, axis=1), axis=-1)
    return np.pad(steps.cumsum(1), ((0, 0), (1, 0)))


def _along(path: Array, at: Array) -> Array:
    """[K, 2] m, a path [T, 2] at lengths [K] in m from its beginning."""
    length = _lengths(path[None])[0]
    return np.stack([np.interp(at, length, path[:, axis]) for axis in range(2)], 1)
