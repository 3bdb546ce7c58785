"""The drivable area and the lanes of a map, by point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import Array, points_in_polygon
from anchorflow_driving.log import DrivingLog, Polylines

CELL = 0.1
"""m, of the grid of the drivable area."""
TILE_BITS = 9
TILE = 1 << TILE_BITS
"""Cells a side of what is worked out at once."""


class Road:
    """A log's drivable area and lanes, in the log's frame."""

    def __init__(self, log: DrivingLog) -> None:
        rings = log.polylines("drivable")
        self._drivable = DrivableGrid(rings)
        self._lanes, self._centres = log.polylines("lane"), log.polylines("centre")
        self._junction = log.lane_intersection
        boxes = [np.concatenate([lane.min(0), lane.max(0)]) for lane in self._lanes]
        self._bounds = np.array(boxes).reshape(-1, 2, 2)

    def is_drivable(self, points: Array) -> NDArray[np.bool_]:
        """[...] of points [..., 2]."""
        return self._drivable.holds(points)

    def in_lanes(self, points: Array) -> NDArray[np.bool_]:
        """Which lanes hold points [..., 2]: [L, ...]."""
        flat = points.reshape(-1, 2)
        held = np.zeros((len(self._lanes), len(flat)), bool)
        if len(flat):
            low, high = flat.min(0), flat.max(0)
            near = (self._bounds[:, 0] <= high).all(1) & (self._bounds[:, 1] >= low).all(1)
            for lane in np.flatnonzero(near):
                low, high = self._bounds[lane]
                here = np.flatnonzero(((flat >= low) & (flat <= high)).all(1))
                held[lane, here] = points_in_polygon(flat[here], self._lanes[lane])
        return held.reshape(len(self._lanes), *points.shape[:-1])

    def against_lanes(self, poses: Array) -> NDArray[np.bool_]:
        """Return [...] whether poses [..., 3] are in lanes that all lead the other way.

        The other way is more than a right angle off; in a crossing one matching lane is enough.
        """
        flat = poses.reshape(-1, 3)
        held = self.in_lanes(flat[:, :2])
        heading = np.stack([np.cos(flat[:, 2]), np.sin(flat[:, 2])], -1)
        along = np.zeros(len(flat), bool)
        for lane in np.flatnonzero(held.any(axis=1)):
            here, centre = np.flatnonzero(held[lane]), self._centres[lane]
            away = flat[here, None, :2] - (centre[1:] + centre[:-1]) / 2
            nearest = (away**2).sum(-1).argmin(1)
            along[here] |= (np.diff(centre, axis=0)[nearest] * heading[here]).sum(-1) > 0
        return (held.any(axis=0) & ~along).reshape(poses.shape[:-1])

    def in_junction(self, in_lanes: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Of what `in_lanes` says: [...] whether one of the lanes belongs to a junction."""
        return np.asarray(in_lanes[self._junction].any(axis=0))


class DrivableGrid:
    """Cells with their middle inside an odd number of rings, computed in tiles on first use."""

    def __init__(self, rings: Polylines) -> None:
        corners = np.concatenate([*rings, np.zeros((0 if rings else 1, 2))])
        ends = [np.roll(ring, -1, axis=0) for ring in rings]
        self._low = corners.min(0) - 1.0
        columns, rows = np.ceil((corners.max(0) + 1.0 - self._low) / CELL).astype(int)
        self._shape = int(rows), int(columns)
        # Edges in units of cells, with the cells' middles at whole numbers.
        self._start, self._end = (
            (np.concatenate([*each, np.zeros((0, 2))]) - self._low) / CELL - 0.5
            for each in (rings, ends)
        )
        # An index into the computed tiles by row and column, or -1, and the tiles; both are
        # replaced at once because of threads.
        place = np.full((-(-rows // TILE), -(-columns // TILE)), -1)
        self._known = place, np.zeros((0, TILE, TILE), bool)

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """[...] of points [..., 2]."""
        column, row = np.moveaxis(np.floor((points - self._low) / CELL).astype(int), -1, 0)
        rows, columns = self._shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        if not inside.any():
            return inside
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        tile = row >> TILE_BITS, column >> TILE_BITS
        place, tiles = self._known
        if (missing := inside & (place[tile] < 0)).any():
            wanted = np.zeros(place.shape, bool)
            wanted[tile[0][missing], tile[1][missing]] = True
            place, tiles = self._known = self._added(place, tiles, wanted)
        return inside & tiles[place[tile], row & (TILE - 1), column & (TILE - 1)]

    def _added(
        self, place: NDArray[np.int_], tiles: NDArray[np.bool_], wanted: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
        """Return the known tiles with the wanted ones added."""
        added = [
            cells_inside(self._start, self._end, (TILE, TILE), first=(row * TILE, column * TILE))
            for row, column in np.argwhere(wanted).tolist()
        ]
        place = place.copy()
        place[wanted] = len(tiles) + np.arange(len(added))
        return place, np.concatenate([tiles, *(tile[None] for tile in added)])


def cells_inside(
    start: Array, end: Array, shape: tuple[int, int], *, first: tuple[int, int] = (0, 0)
) -> NDArray[np.bool_]:
    """Cells [rows, columns] inside an odd number of rings, whose edges [E, 2] are given in cells.

    Even-odd rule: every edge toggles, in each row that it crosses, all cells to its right. A cell's
    middle has whole numbers.

    first: row and column of the first cell
    """
    (rows, columns), (first_row, first_column) = shape, first
    upward = (start[:, 1] <= end[:, 1])[:, None]
    below, above = np.where(upward, start, end), np.where(upward, end, start)
    lowest = np.clip(np.ceil(below[:, 1]).astype(int) - first_row, 0, rows)
    crossings = np.clip(np.ceil(above[:, 1]).astype(int) - first_row, 0, rows) - lowest
    edge = np.repeat(np.arange(len(below)), crossings)
    row = np.arange(crossings.sum()) - np.repeat(crossings.cumsum() - crossings, crossings)
    row += lowest[edge]
    (x0, y0), (x1, y1) = below[edge].T, above[edge].T
    column = np.ceil(x0 + (row + first_row - y0) / (y1 - y0) * (x1 - x0)).astype(int)
    column = (column - first_column).clip(0, columns)
    toggles = np.bincount(row * (columns + 1) + column, minlength=rows * (columns + 1))
    toggles = toggles.reshape(rows, columns + 1)[:, :-1].astype(np.uint8) & 1
    return np.bitwise_xor.accumulate(toggles, axis=1).astype(bool)
