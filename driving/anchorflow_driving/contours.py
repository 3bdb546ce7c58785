"""The union of polygons as rings, by a raster: what overlaps counts once, slivers close."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from anchorflow_driving.geometry import Array
from anchorflow_driving.road import cells_inside

CELL = 0.2
"""m"""
BLUR = 2.0
"""Cells by which the raster is blurred, so that contours lie between its cells."""
TOLERANCE = 0.04
"""m by which a ring may leave its contour when points are left out."""
MARGIN = 3.0
"""m of the raster around what is looked at: contours must close in it."""
LEAST_AREA = 4.0
"""m² of a ring; smaller holes and islands are artefacts."""


def union_rings(
    added: Sequence[Array],
    taken: Sequence[Array] = (),
    *,
    again: Sequence[Array] = (),
    level: float,
    within: tuple[Array, Array] | None = None,
) -> list[Array]:
    """Rings [V, 2] around the union of polygons `added`, less `taken`, and `again` after all.

    level: of the blurred raster; below 0.5 the rings lie outside (0.23: 0.3 m)
    within: low and high corner of a box, outside of which nothing is looked at
    """
    if not added:
        return []
    corners = np.concatenate(added)
    low, high = corners.min(0), corners.max(0)
    if within is not None:
        low, high = np.maximum(low, within[0]), np.minimum(high, within[1])
        if (low >= high).any():
            return []
    low, high = low - MARGIN, high + MARGIN
    columns, rows = np.ceil((high - low) / CELL).astype(int)
    covered = np.zeros((rows, columns), np.float32)
    for polygons, value in ((added, 1.0), (taken, 0.0), (again, 1.0)):
        for polygon in polygons:
            _fill(covered, (polygon - low) / CELL - 0.5, value)
    rim = round(MARGIN / CELL)
    covered[:rim] = covered[-rim:] = covered[:, :rim] = covered[:, -rim:] = 0.0
    rings = contour_rings(gaussian_filter(covered, BLUR).astype(np.float32), level)
    rings = [(ring + 0.5) * CELL + low for ring in rings]
    return [_simplified(ring) for ring in rings if abs(_area(ring)) > LEAST_AREA]


def keyholed(exterior: Array, holes: Sequence[Array]) -> Array:
    """A polygon with holes as one ring [V, 2]: a line leads to each hole and back."""
    parts = [exterior]
    for hole in holes:
        parts += [exterior[:1], hole, hole[:1]]
    return np.concatenate([*parts, exterior[:1]] if holes else parts)


def contour_rings(values: NDArray[np.float32], level: float) -> list[Array]:
    """Marching squares: closed lines (column, row) [V, 2] where `values` cross the level.

    The values on the border must lie below it.
    """
    inside = values >= level
    columns = values.shape[1]
    # A crossing is known by the sample before it and the axis of its edge.
    across = np.flatnonzero(inside[:, :-1] != inside[:, 1:])
    row, column = np.divmod(across, columns - 1)
    along_x = row * columns + column
    along_y = np.flatnonzero((inside[:-1] != inside[1:]).ravel())
    before = np.concatenate([along_x, along_y])
    after = np.concatenate([along_x + 1, along_y + columns])
    flat = values.ravel().astype(np.float64)
    share = (level - flat[before]) / (flat[after] - flat[before])
    y, x = np.divmod(before, columns)
    points = np.stack([x, y], -1).astype(np.float64)
    horizontal = np.arange(len(before)) < len(along_x)
    points[horizontal, 0] += share[horizontal]
    points[~horizontal, 1] += share[~horizontal]
    keys = np.concatenate([2 * along_x, 2 * along_y + 1]).tolist()
    return _linked(_segments(inside, columns), dict(zip(keys, points, strict=True)))


def _segments(inside: NDArray[np.bool_], columns: int) -> dict[int, list[int]]:
    """Crossings by the crossings that they are joined with in a square of four samples."""
    a, b, c, d = inside[:-1, :-1], inside[:-1, 1:], inside[1:, 1:], inside[1:, :-1]
    mixed = (a | b | c | d) & ~(a & b & c & d)
    rows, cols = np.nonzero(mixed)
    origin = rows * columns + cols
    sides = np.stack(  # bottom, right, top, left
        [2 * origin, 2 * (origin + 1) + 1, 2 * (origin + columns), 2 * origin + 1], -1
    ).tolist()
    crossed = np.stack(
        [(a != b)[mixed], (b != c)[mixed], (c != d)[mixed], (d != a)[mixed]], -1
    ).tolist()
    first = a[mixed].tolist()
    joined: dict[int, list[int]] = {}
    for keys, which, corner in zip(sides, crossed, first, strict=True):
        ends = [key for key, yes in zip(keys, which, strict=True) if yes]
        if len(ends) == 4:  # a saddle: cut off the corners that are outside
            bottom, right, top, left = ends
            pairs = [(bottom, right), (top, left)] if corner else [(left, bottom), (right, top)]
        else:
            pairs = [(ends[0], ends[1])]
        for one, other in pairs:
            joined.setdefault(one, []).append(other)
            joined.setdefault(other, []).append(one)
    return joined


def _linked(joined: dict[int, list[int]], points: dict[int, Array]) -> list[Array]:
    rings, left = [], set(joined)
    for start in joined:
        if start not in left:
            continue
        ring, here = [], start
        while here in left:
            left.discard(here)
            ring.append(points[here])
            one, other = joined[here]
            here = one if one in left else other
        rings.append(np.array(ring))
    return rings


def _fill(covered: NDArray[np.float32], polygon: Array, value: float) -> None:
    """Set the cells with their middle inside a polygon, given in cells."""
    low = np.maximum(np.floor(polygon.min(0)).astype(int), 0)
    high = np.maximum(np.ceil(polygon.max(0)).astype(int) + 1, 0)
    block = covered[low[1] : high[1], low[0] : high[0]]
    if not block.size:
        return
    inside = cells_inside(polygon - low, np.roll(polygon, -1, axis=0) - low, block.shape)
    block[inside] = value


def _area(ring: Array) -> float:
    x, y = (ring - ring[0]).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def _simplified(ring: Array) -> Array:
    """Fewer points, none left out farther than TOLERANCE (Douglas and Peucker, 1973)."""
    far = int(np.linalg.norm(ring - ring[0], axis=1).argmax())
    kept = np.zeros(len(ring) + 1, bool)
    kept[[0, far, len(ring)]] = True
    closed = np.concatenate([ring, ring[:1]])
    spans = [(0, far), (far, len(ring))]
    while spans:
        begin, end = spans.pop()
        if end - begin < 2:
            continue
        chord = closed[end] - closed[begin]
        length = float(np.hypot(*chord))
        offset = closed[begin + 1 : end] - closed[begin]
        away = np.abs(chord[0] * offset[:, 1] - chord[1] * offset[:, 0]) / max(length, 1e-9)
        worst = int(away.argmax())
        if away[worst] > TOLERANCE:
            middle = begin + 1 + worst
            kept[middle] = True
            spans += [(begin, middle), (middle, end)]
    return ring[kept[:-1]]
