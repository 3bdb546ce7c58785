"""A robot's outline on a map: whether it touches an occupied cell, exactly, pose by pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.caching import cached_property
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.cost.clearance import clearance_field

SIDES = 16  # corners of the polygon about a disc


class Ground(NamedTuple):
    """A map as outlines are tested on it.

    before: [H, W + 1] occupied cells of each row to the left of a column
    room: [H, W] m from each cell's centre to the nearest occupied cell or the map's edge
    x, y: m, the outer corner of cell (0, 0); resolution: m/cell
    """

    before: NDArray[np.int32]
    room: NDArray[np.float32]
    x: float
    y: float
    resolution: float


def ground_of(occupied: BoolArray, resolution: float, origin: FloatArray) -> Ground:
    """Return the ground of occupied cells [H, W]."""
    before = np.zeros((occupied.shape[0], occupied.shape[1] + 1), np.int32)
    np.cumsum(occupied, axis=1, out=before[:, 1:])
    room = np.ascontiguousarray(clearance_field(occupied, resolution, 0.0))
    return Ground(before, room, float(origin[0]), float(origin[1]), float(resolution))


@dataclass(frozen=True, eq=False)
class Outline:
    """A convex polygon about the robot's origin: corners [K, 2] in m, counter-clockwise."""

    corners: NDArray[np.float64]

    @staticmethod
    def disc(radius: float) -> Outline:
        """Return a polygon that holds a disc."""
        angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
        corner = max(radius, 1e-3) / np.cos(np.pi / SIDES)
        return Outline(corner * np.stack([np.cos(angles), np.sin(angles)], 1))

    @cached_property
    def reach(self) -> float:
        """m from the origin to the farthest corner."""
        return float(np.hypot(*self.corners.T).max())

    @property
    def inner(self) -> float:
        """m from the origin to the nearest edge."""
        edge, normal = self._edges
        del edge
        return float((normal * self.corners).sum(1).min())

    @cached_property
    def _made(self) -> dict[tuple[str, float], Any]:
        """Grown outlines by their margin and rims by their spacing, which a plan needs again."""
        return {}

    @cached_property
    def _edges(self) -> tuple[FloatArray, FloatArray]:
        """The edges [K, 2] from each corner on, and their outward normals of length 1."""
        edge = np.roll(self.corners, -1, 0) - self.corners
        normal = np.stack([edge[:, 1], -edge[:, 0]], 1)
        return edge, normal / np.hypot(*normal.T)[:, None]

    def grown(self, margin: float) -> Outline:
        """Return the polygon whose edges lie `margin` m farther out."""
        if (made := self._made.get(("grown", margin))) is None:
            made = self._made["grown", margin] = self._grown(margin)
        return made

    def _grown(self, margin: float) -> Outline:
        _, after = self._edges
        before = np.roll(after, 1, 0)
        # Both edges of a corner move: shift it along the sum of their normals.
        shift = (before + after) / (1.0 + (before * after).sum(1))[:, None]
        return Outline(self.corners + margin * shift)

    def rim(self, spacing: float) -> NDArray[np.float64]:
        """Return points [P, 2] along the edges, corners among them, at most `spacing` m apart."""
        if (made := self._made.get(("rim", spacing))) is None:
            made = self._made["rim", spacing] = self._rim(spacing)
        return made

    def _rim(self, spacing: float) -> NDArray[np.float64]:
        points = []
        for corner, edge in zip(self.corners, self._edges[0], strict=True):
            count = max(1, int(np.ceil(np.hypot(*edge) / spacing)))
            points.append(corner + edge * (np.arange(count) / count)[:, None])
        return np.concatenate(points)


def covered(
    outline: Outline,
    pose: FloatArray,
    *,
    resolution: float,
    origin: FloatArray,
    shape: tuple[int, int],
) -> BoolArray:
    """Return [H, W], the cells that an outline at a pose [3] covers or touches."""
    rows, columns = np.indices(shape)
    at = origin + resolution * (np.stack([columns, rows], -1) + 0.5) - pose[:2]
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    inside = at @ np.array([[cosine, -sine], [sine, cosine]])
    grown = outline.grown(resolution / np.sqrt(2.0))
    _, normal = grown._edges
    return (inside @ normal.T <= (normal * grown.corners).sum(1)).all(-1)


@compiled
def touches(
    ground: Ground, corners: FloatArray, reach: float, pose: FloatArray, spans: FloatArray
) -> bool:
    """Whether a convex polygon [K, 2] at a pose [3] touches an occupied cell or leaves the map.

    A polygon meets a cell of a row exactly if the cell's columns meet those that the part of the
    polygon in this row spans, and the ends of this span lie on edges.

    reach: m from the origin to the farthest corner; spans: [2, H], room to work in
    """
    height, width = ground.room.shape
    u, v = (pose[0] - ground.x) / ground.resolution, (pose[1] - ground.y) / ground.resolution
    row, column = int(np.floor(v)), int(np.floor(u))
    if row < 0 or column < 0 or row >= height or column >= width:
        return True
    if ground.room[row, column] > reach + 0.71 * ground.resolution:
        return False
    cosine, sine = np.cos(pose[2]) / ground.resolution, np.sin(pose[2]) / ground.resolution
    low, high = v, v
    for k in range(len(corners)):
        y = v + sine * corners[k, 0] + cosine * corners[k, 1]
        low, high = min(low, y), max(high, y)
    lowest, highest = int(np.floor(low)), int(np.floor(high))
    if lowest < 0 or highest >= height:
        return True
    spans[0, lowest : highest + 1], spans[1, lowest : highest + 1] = np.inf, -np.inf
    before = len(corners) - 1
    for k in range(len(corners)):
        (px, py), (qx, qy) = corners[before], corners[k]
        _span_edge(
            u + cosine * px - sine * py,
            v + sine * px + cosine * py,
            u + cosine * qx - sine * qy,
            v + sine * qx + cosine * qy,
            spans,
        )
        before = k
    for line in range(lowest, highest + 1):
        left, right = int(np.floor(spans[0, line])), int(np.floor(spans[1, line]))
        if left < 0 or right >= width:
            return True
        if ground.before[line, right + 1] > ground.before[line, left]:
            return True
    return False


@compiled
def _span_edge(px: float, py: float, qx: float, qy: float, spans: FloatArray) -> None:
    """Widen the spans [2, H] of the rows that an edge between two points in cells passes."""
    low, high = min(py, qy), max(py, qy)
    slope = (qx - px) / (qy - py) if qy != py else 0.0
    for line in range(int(np.floor(low)), int(np.floor(high)) + 1):
        if qy != py:
            a, b = px + slope * (max(low, line) - py), px + slope * (min(high, line + 1) - py)
        else:
            a, b = px, qx
        spans[0, line] = min(spans[0, line], a, b)
        spans[1, line] = max(spans[1, line], a, b)
