"""A rolling occupancy grid round the robot, built from nothing but its scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.closed_loop.lidar import Scan

Array = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

# Log odds that a scan adds to a cell that it hits or looks through, and where they end.
HIT, MISS = 1.5, -0.4
LEAST, MOST = -2.0, 4.0
LOOKED_THROUGH = 3  # beams that point at a cell and may end behind it
REMEMBERED = 30.0  # hits of a cell over which their mean place is taken


class LocalMap:
    """cells × cells of `resolution` m, kept centred on the robot in steps of whole cells.

    What no beam has told of counts as free: a robot that took the unseen for occupied would plan
    no way out of its own field of view. Poses are taken for exact. A cell is hit where no fewer
    beams end in it than go on behind it, so that a few that end early narrow no gap. Within a
    cell the mean place of its hits is kept, which is nearer to the surface than the cell's rim.
    """

    def __init__(self, *, cells: int = 128, resolution: float = 0.08) -> None:
        self.resolution = resolution
        self._log_odds = np.zeros((cells, cells), np.float32)
        self._hits = np.zeros((cells, cells), np.float32)
        self._places = np.zeros((cells, cells, 2), np.float32)  # m from a cell's lower corner
        self._corner = np.zeros(2, np.int64)  # cell (0, 0), counted in cells from the frame's (0,0)

    @property
    def origin(self) -> Array:
        """[2] m, outer corner of cell (0, 0)."""
        return self._corner * self.resolution

    @property
    def occupied(self) -> BoolArray:
        """[H, W], row index grows with y."""
        return self._log_odds > 0.0

    @property
    def surface(self) -> Array:
        """[H, W, 2] m, the mean place of each cell's hits; the cell's centre where it has none."""
        within = np.where(self._hits[..., None] > 0.0, self._places, 0.5 * self.resolution)
        return self._centres() - 0.5 * self.resolution + within

    def occupied_beyond(self, position: Array, radius: float) -> BoolArray:
        """[H, W] without what lies within `radius` m of a robot at [2]: it cannot be there."""
        offset = self._centres() - position
        return self.occupied & ((offset**2).sum(-1) > radius**2)

    def add(self, scan: Scan) -> None:
        """Move the window to the robot and take a scan in."""
        self._move_to(scan.pose[:2])
        offset = self._centres() - scan.pose[:2]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        bearing = np.arctan2(offset[..., 1], offset[..., 0]) - scan.pose[2]
        through, beams_through = self._seen_through(scan, bearing, distance)
        ended = self._end_in_cells(scan)
        hit = (ended > 0) & (ended >= beams_through)
        self._log_odds[(through | (ended > 0)) & ~hit] += MISS
        self._log_odds[hit] += HIT
        np.clip(self._log_odds, LEAST, MOST, out=self._log_odds)

    def _seen_through(
        self, scan: Scan, bearing: Array, distance: Array
    ) -> tuple[BoolArray, NDArray[np.int64]]:
        """[H, W]: whether all beams that point at a cell end behind it, and how many do."""
        spacing = scan.bearings[1] - scan.bearings[0]
        turned = np.remainder(bearing + np.pi, 2.0 * np.pi) - np.pi
        beam = np.rint((turned - scan.bearings[0]) / spacing).astype(np.int64)
        seen = (beam >= 0) & (beam < len(scan.ranges))
        # A cell is as wide as several beams when it is near.
        beyond = distance + 0.5 * self.resolution
        beside = LOOKED_THROUGH // 2
        padded = np.pad(scan.ranges, beside, mode="edge")
        nearest = np.clip(beam, 0, len(scan.ranges) - 1)
        count = np.zeros(distance.shape, np.int64)
        for offset in range(LOOKED_THROUGH):
            count += padded[nearest + offset] > beyond
        count[~seen] = 0
        return count == LOOKED_THROUGH, count

    def _end_in_cells(self, scan: Scan) -> NDArray[np.int64]:
        """[H, W], how many beams end in each cell; takes note of where."""
        angles = scan.bearings[scan.hits] + scan.pose[2]
        directions = np.stack([np.cos(angles), np.sin(angles)], 1)
        ends = scan.pose[:2] + scan.ranges[scan.hits, None] * directions
        cells = np.floor(ends / self.resolution).astype(np.int64)
        size = len(self._log_odds)
        inside = ((cells >= self._corner) & (cells < self._corner + size)).all(1)
        columns, rows = (cells[inside] - self._corner).T
        places = ends[inside] - cells[inside] * self.resolution
        flat, index, counts = np.unique(
            rows * size + columns, return_inverse=True, return_counts=True
        )
        ended = np.zeros(size * size, np.int64)
        ended[flat] = counts
        hits, mean = self._hits.reshape(-1), self._places.reshape(-1, 2)
        before, total = hits[flat], hits[flat] + counts
        for axis in range(2):
            summed = np.bincount(index, places[:, axis], len(flat))
            mean[flat, axis] = (before * mean[flat, axis] + summed) / total
        hits[flat] = np.minimum(total, REMEMBERED)
        return ended.reshape(size, size)

    def _move_to(self, position: Array) -> None:
        size = len(self._log_odds)
        corner = np.floor(position / self.resolution).astype(np.int64) - size // 2
        columns, rows = np.clip(corner - self._corner, -size, size)
        to = _left_over(-rows, size), _left_over(-columns, size)
        kept = _left_over(rows, size), _left_over(columns, size)

        def moved(values: Array) -> Array:
            left = np.zeros_like(values)
            left[to] = values[kept]
            return left

        self._log_odds, self._hits, self._places = map(
            moved, (self._log_odds, self._hits, self._places)
        )
        self._corner = corner

    def _centres(self) -> Array:
        """[H, W, 2] m, centres of the cells."""
        steps = (np.arange(len(self._log_odds)) + 0.5) * self.resolution
        x, y = np.meshgrid(steps + self.origin[0], steps + self.origin[1])
        return np.stack([x, y], -1)


def _left_over(shift: int, size: int) -> slice:
    """The part of `size` cells that stays in a window that moves on by `shift`."""
    return slice(max(shift, 0), size + min(shift, 0))
