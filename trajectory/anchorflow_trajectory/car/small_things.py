"""Small things that a LiDAR sees and no predicted occupancy explains: people, cyclists, barriers.

Each is a group of points in a histogram seen from above. Its velocity is that of the group's middle
since the sweep before, if the nearest groups of both sweeps belong together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

SWEEPS_S = 0.5
"""s between the two sweeps."""
KNOWN = 0.35
"""Predicted occupancy near a point from which on it is explained."""
FEW = 0.35
"""Sum of a group's cells, each in [0, 1], below which it is noise."""
WIDE, MOVED_ON = 1.2, 3
"""m of a group that may be a vehicle and whose points are things of their own, and cells from
predicted occupancy that explains it."""
MOVED, STILL = (3.0, 8.0), 0.5
"""m between two sweeps at most, of narrow and wide groups; m/s below which a group stands."""
AROUND_M = 40.0
"""m from the rear axle up to which things count; those behind it do not."""
BESIDE_M, MOST = 8.0, 128
"""m beside a course up to which things are near it, and how many of them count."""


@dataclass(frozen=True, eq=False)
class SmallThings:
    """K discs: places [K,2] now, velocities [K,2] m/s, radii [K] m."""

    places: FloatArray
    velocities: FloatArray
    radii: FloatArray

    @classmethod
    def seen(cls, now: Raster, before: Raster | None, taken: Raster, car: Car) -> SmallThings:
        """Find them in two sweeps, both in the frame of now.

        before: None if there is no earlier sweep; then nothing moves
        taken: predicted occupancy, the first layer of which is nearly that of now
        """
        discs, points, group = _groups(now, taken, car)
        velocities = np.zeros((len(discs), 2))
        if before is not None:
            velocities = _velocities(discs, _groups(before, taken, car)[0])
        narrow = discs[:, 2] <= WIDE / 2
        places = np.concatenate([discs[narrow, :2], points])
        velocities = np.concatenate([velocities[narrow], velocities[group]])
        radii = np.concatenate([discs[narrow, 2], np.full(len(points), now.cell / 2)])
        near = np.hypot(*places.T) < AROUND_M
        return cls(places[near], velocities[near], radii[near])

    def near(self, course: Course) -> SmallThings:
        """Return those near a course, at most MOST of them, the nearest to the car."""
        _, left = course.project(self.places)
        few = np.argsort(np.hypot(*self.places.T) + 1e3 * (np.abs(left) > BESIDE_M))[:MOST]
        few = few[np.abs(left[few]) <= BESIDE_M]
        return SmallThings(self.places[few], self.velocities[few], self.radii[few])


def _velocities(now: FloatArray, before: FloatArray) -> FloatArray:
    """Return the m/s [K,2] of discs [K,3], by those of the sweep before [J,3]."""
    velocities = np.zeros((len(now), 2))
    if not (len(now) and len(before)):
        return velocities
    apart = np.linalg.norm(now[:, None, :2] - before[:, :2], axis=-1)
    wide = now[:, 2] > WIDE / 2
    apart[wide[:, None] != (before[:, 2] > WIDE / 2)] = np.inf
    nearest, each = apart.argmin(1), np.arange(len(now))
    most = np.where(wide, MOVED[1], MOVED[0])
    same = (apart.argmin(0)[nearest] == each) & (apart[each, nearest] < most)
    velocities[same] = (now - before[nearest])[same, :2] / SWEEPS_S
    velocities[np.linalg.norm(velocities, axis=1) < STILL] = 0.0
    return velocities


def _groups(
    sweep: Raster, taken: Raster, car: Car
) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Return groups [K,3] as x, y, radius; the points [P,2] of wide ones, and whose they are [P].

    A group is explained if predicted occupancy is next to half of its points; a wide one also if
    it is near the group's middle, since the first layer is a little later than the sweep.
    """
    row, column = np.nonzero(sweep.values[0])
    x, y = places_of(sweep, row, column)
    rest = (x > 0.0) & ((x > car.front) | (np.abs(y) > car.side))
    row, column, points = row[rest], column[rest], np.stack([x, y], -1)[rest]
    _, label = np.unique(_labels(row, column, sweep.values.shape[1:]), return_inverse=True)
    share = sweep.values[0][row, column].astype(np.float64)
    count, weight = np.bincount(label), np.bincount(label, share)
    low, high = np.full((len(count), 2), np.inf), np.full((len(count), 2), -np.inf)
    np.minimum.at(low, label, points)
    np.maximum.at(high, label, points)
    middle = np.stack([np.bincount(label, share * each) / weight for each in points.T], -1)
    size = high - low + sweep.cell
    radius = np.linalg.norm(size, axis=1) / 2
    wide = radius > WIDE / 2
    explained = np.bincount(label, _is_known(taken, points, 1)) > count / 2
    explained |= wide & _is_known(taken, middle, MOVED_ON)
    there = (weight >= FEW) & ~explained
    discs, of = np.concatenate([middle, radius[:, None]], 1)[there], np.cumsum(there) - 1
    kept = (there & wide)[label]
    return discs, points[kept], of[label[kept]]


def _is_known(taken: Raster, places: FloatArray, cells: int) -> BoolArray:
    """Return whether predicted occupancy is so near to places [K,2]."""
    inside, row, column = cells_at(taken, *places.T)
    return inside & _known(taken, cells)[row, column]


def _known(taken: Raster, cells: int) -> BoolArray:
    """Return which cells [H,W] are so near to others that are taken."""
    about = sliding_window_view(np.pad(taken.values[0], cells), (2 * cells + 1,) * 2)
    return about.max((2, 3)) > KNOWN


def _labels(
    row: NDArray[np.intp], column: NDArray[np.intp], shape: tuple[int, ...]
) -> NDArray[np.intp]:
    """Return [K] equal numbers for cells that neighbours join."""
    at = np.full((shape[0] + 2, shape[1] + 2), len(row))
    at[row + 1, column + 1] = np.arange(len(row))
    shifts = [(i, j) for i in range(3) for j in range(3)]
    neighbours = np.stack([at[row + i, column + j] for i, j in shifts])
    labels = np.append(np.arange(len(row)), -1)
    while True:
        joined = labels[neighbours].max(0, initial=-1)
        if np.array_equal(joined, labels[:-1]):
            return joined
        labels[:-1] = joined


def places_of(
    raster: Raster, row: NDArray[np.intp], column: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Return x and y of the middles of cells."""
    return (
        raster.extent[1] - (row + 0.5) * raster.cell,
        raster.extent[3] - (column + 0.5) * raster.cell,
    )


def cells_at(
    raster: Raster, x: FloatArray, y: FloatArray
) -> tuple[BoolArray, NDArray[np.intp], NDArray[np.intp]]:
    """Return whether places are in a raster, and their cells, or those nearest to them."""
    rows, columns = raster.values.shape[1:]
    row = np.floor((raster.extent[1] - x) / raster.cell).astype(np.intp)
    column = np.floor((raster.extent[3] - y) / raster.cell).astype(np.intp)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    return inside, row.clip(0, rows - 1), column.clip(0, columns - 1)
