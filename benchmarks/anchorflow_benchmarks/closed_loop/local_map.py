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


class LocalMap:
    """cells × cells of `resolution` m, kept centred on the robot in steps of whole cells.

    What no beam has told of counts as free: a robot that took the unseen for occupied would plan
    no way out of its own field of view. Poses are taken for exact.
    """

    def __init__(self, *, cells: int = 128, resolution: float = 0.08) -> None:
        self.resolution = resolution
        self._log_odds = np.zeros((cells, cells), np.float32)
        self._corner = np.zeros(2, np.int64)  # cell (0, 0), counted in cells from the frame's (0,0)

    @property
    def origin(self) -> Array:
        """[2] m, outer corner of cell (0, 0)."""
        return self._corner * self.resolution

    @property
    def occupied(self) -> BoolArray:
        """[H, W], row index grows with y."""
        return self._log_odds > 0.0

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
        free = distance < self._seen_through(scan, bearing)
        hit = self._hit_cells(scan)
        self._log_odds[free & ~hit] += MISS
        self._log_odds[hit] += HIT
        np.clip(self._log_odds, LEAST, MOST, out=self._log_odds)

    def _seen_through(self, scan: Scan, bearing: Array) -> Array:
        """[H, W] m up to which the space in the direction of each cell is seen to be free."""
        spacing = scan.bearings[1] - scan.bearings[0]
        turned = np.remainder(bearing + np.pi, 2.0 * np.pi) - np.pi
        beam = np.rint((turned - scan.bearings[0]) / spacing).astype(np.int64)
        seen = (beam >= 0) & (beam < len(scan.ranges))
        # A cell is as wide as several beams when it is near: none of its neighbours may end in it.
        padded = np.pad(scan.ranges, 1, mode="edge")
        shortest = np.minimum(np.minimum(padded[:-2], padded[2:]), scan.ranges)
        reach = shortest[np.clip(beam, 0, len(shortest) - 1)] - 0.5 * self.resolution
        return np.where(seen, reach, 0.0)

    def _hit_cells(self, scan: Scan) -> BoolArray:
        angles = scan.bearings[scan.hits] + scan.pose[2]
        directions = np.stack([np.cos(angles), np.sin(angles)], 1)
        ends = scan.pose[:2] + scan.ranges[scan.hits, None] * directions
        columns_rows = np.floor(ends / self.resolution).astype(np.int64) - self._corner
        size = len(self._log_odds)
        columns, rows = columns_rows[((columns_rows >= 0) & (columns_rows < size)).all(1)].T
        hit = np.zeros(self._log_odds.shape, bool)
        hit[rows, columns] = True
        return hit

    def _move_to(self, position: Array) -> None:
        size = len(self._log_odds)
        corner = np.floor(position / self.resolution).astype(np.int64) - size // 2
        columns, rows = np.clip(corner - self._corner, -size, size)
        moved = np.zeros_like(self._log_odds)
        moved[_left_over(-rows, size), _left_over(-columns, size)] = self._log_odds[
            _left_over(rows, size), _left_over(columns, size)
        ]
        self._log_odds, self._corner = moved, corner

    def _centres(self) -> Array:
        """[H, W, 2] m, centres of the cells."""
        steps = (np.arange(len(self._log_odds)) + 0.5) * self.resolution
        x, y = np.meshgrid(steps + self.origin[0], steps + self.origin[1])
        return np.stack([x, y], -1)


def _left_over(shift: int, size: int) -> slice:
    """The part of `size` cells that stays in a window that moves on by `shift`."""
    return slice(max(shift, 0), size + min(shift, 0))
