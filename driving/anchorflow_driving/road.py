"""Where one may drive, and which lanes a point lies in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import points_in_polygon
from anchorflow_driving.log import DrivingLog, Polylines

Array = NDArray[np.float64]

CELL = 0.1
"""m, of the grid of the drivable area."""


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
        """[...] whether poses [..., 3] lie in lanes, all of which lead the other way: by more than
        a right angle. Where lanes cross or share a place, one of them is enough.
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
    """Cells whose middles lie inside an odd number of rings."""

    def __init__(self, rings: Polylines) -> None:
        if not rings:
            self._low, self._cells = np.zeros(2), np.zeros((1, 1), bool)
            return
        start = np.concatenate(rings)
        end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
        self._low = start.min(0) - 1.0
        columns, rows = np.ceil((start.max(0) + 1.0 - self._low) / CELL).astype(int)
        # In cells, with their middles at whole numbers.
        start, end = ((ends - self._low) / CELL - 0.5 for ends in (start, end))
        self._cells = cells_inside(start, end, (rows, columns))

    def holds(self, points: Array) -> NDArray[np.bool_]:
        column, row = np.moveaxis(np.floor((points - self._low) / CELL).astype(int), -1, 0)
        rows, columns = self._cells.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return inside & self._cells[np.where(inside, row, 0), np.where(inside, column, 0)]


def cells_inside(start: Array, end: Array, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Cells [rows, columns] inside an odd number of rings, whose edges [E, 2] are given in cells.

    Even-odd rule: every edge toggles, in each row that it crosses, all cells to its right. A cell's
    middle has whole numbers.
    """
    rows, columns = shape
    upward = (start[:, 1] <= end[:, 1])[:, None]
    below, above = np.where(upward, start, end), np.where(upward, end, start)
    first = np.clip(np.ceil(below[:, 1]), 0, rows).astype(int)
    last = np.clip(np.ceil(above[:, 1]), 0, rows).astype(int)
    crossings = last - first
    edge = np.repeat(np.arange(len(below)), crossings)
    row = np.arange(crossings.sum()) - np.repeat(crossings.cumsum() - crossings, crossings)
    row += first[edge]
    (x0, y0), (x1, y1) = below[edge].T, above[edge].T
    column = np.ceil(x0 + (row - y0) / (y1 - y0) * (x1 - x0)).clip(0, columns).astype(int)
    toggles = np.bincount(row * (columns + 1) + column, minlength=rows * (columns + 1))
    toggles = toggles.reshape(rows, columns + 1)[:, :-1].astype(np.uint8) & 1
    return np.bitwise_xor.accumulate(toggles, axis=1).astype(bool)
