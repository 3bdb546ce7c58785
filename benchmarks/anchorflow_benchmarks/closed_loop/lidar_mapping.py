"""A planar lidar, and a rolling occupancy grid that is built from its scans alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.closed_loop.worlds import World

Array = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

# Log odds that a scan adds to cells it hits or looks through, and their bounds.
HIT, MISS = 1.5, -0.4
MIN_LOG_ODDS, MAX_LOG_ODDS = -2.0, 4.0
BEAMS_THROUGH = 3  # beams towards a cell that have to end behind it
MAX_HITS = 30.0  # of a cell, over which their mean place is taken


@dataclass(frozen=True, eq=False)
class Scan:
    """pose: [3] x, y in m, yaw in rad, of the robot; bearings: [L] rad in the robot's frame.

    ranges: [L] m; hits: [L], False for beams without an obstacle in range
    """

    pose: Array
    bearings: Array
    ranges: Array
    hits: NDArray[np.bool_]


@dataclass(frozen=True)
class Lidar:
    """beams over field_of_view rad, up to max_range m; noise: m, standard deviation of a range."""

    field_of_view: float
    beams: int = 360
    max_range: float = 10.0
    noise: float = 0.01

    def scan(self, world: World, pose: Array, rng: np.random.Generator) -> Scan:
        """Scan from a pose [3]."""
        bearings = self.field_of_view * ((np.arange(self.beams) + 0.5) / self.beams - 0.5)
        angles = bearings + pose[2]
        distances = ray_distances(
            (world.posts - pose[:2]).astype(np.float32), world.post_radius, angles
        )
        hits = distances < self.max_range
        noisy = np.maximum(distances + rng.normal(0.0, self.noise, self.beams), 0.0)
        return Scan(np.array(pose), bearings, np.where(hits, noisy, self.max_range), hits)


def ray_distances(centres: Array, radius: float, angles: Array) -> Array:
    """Return the m [L] from the origin to the nearest circle along each angle; inf without one.

    centres: [M, 2] m
    """
    directions = np.stack([np.cos(angles), np.sin(angles)], 1).astype(centres.dtype)
    # |s u - c|^2 = r^2 has the roots s = u.c ± sqrt((u.c)^2 - (c.c - r^2)).
    along = directions @ centres.T
    discriminant = along**2 - ((centres**2).sum(1) - centres.dtype.type(radius) ** 2)
    entry = along - np.sqrt(np.maximum(discriminant, 0.0))
    met = (discriminant >= 0.0) & (along > 0.0)
    return np.maximum(np.where(met, entry, np.inf).min(1, initial=np.inf), 0.0)


class LocalMap:
    """cells × cells of `resolution` m, kept centred on the robot in steps of whole cells.

    Unseen cells count as free: otherwise the robot could not plan beyond its field of view. Poses
    are exact. A cell is hit if at least as many beams end in it as behind it, so that a few short
    beams do not narrow a gap. The mean of a cell's hits is nearer to the surface than its rim.
    """

    def __init__(self, *, cells: int = 128, resolution: float = 0.08) -> None:
        self.resolution = resolution
        self._log_odds = np.zeros((cells, cells), np.float32)
        self._hits = np.zeros((cells, cells), np.float32)
        self._places = np.zeros((cells, cells, 2), np.float32)  # m from a cell's lower corner
        self._corner = np.zeros(2, np.int64)  # cell (0, 0), in cells from the frame's (0, 0)

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
        """[H, W, 2] m, the mean place of each cell's hits, or its centre without hits."""
        within = np.where(self._hits[..., None] > 0.0, self._places, 0.5 * self.resolution)
        return self._centres() - 0.5 * self.resolution + within

    def occupied_beyond(self, position: Array, radius: float) -> BoolArray:
        """Return occupied cells [H, W] except within `radius` m of the robot at [2]."""
        offset = self._centres() - position
        return self.occupied & ((offset**2).sum(-1) > radius**2)

    def add(self, scan: Scan) -> None:
        """Move the window to the robot and integrate a scan."""
        self._move_to(scan.pose[:2])
        offset = self._centres() - scan.pose[:2]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        bearing = np.arctan2(offset[..., 1], offset[..., 0]) - scan.pose[2]
        through, beams_through = self._seen_through(scan, bearing, distance)
        ended = self._end_in_cells(scan)
        hit = (ended > 0) & (ended >= beams_through)
        self._log_odds[(through | (ended > 0)) & ~hit] += MISS
        self._log_odds[hit] += HIT
        np.clip(self._log_odds, MIN_LOG_ODDS, MAX_LOG_ODDS, out=self._log_odds)

    def _seen_through(
        self, scan: Scan, bearing: Array, distance: Array
    ) -> tuple[BoolArray, NDArray[np.int64]]:
        """Return [H, W] whether all beams towards a cell end behind it, and how many do."""
        spacing = scan.bearings[1] - scan.bearings[0]
        turned = np.remainder(bearing + np.pi, 2.0 * np.pi) - np.pi
        beam = np.rint((turned - scan.bearings[0]) / spacing).astype(np.int64)
        seen = (beam >= 0) & (beam < len(scan.ranges))
        # A near cell is as wide as several beams.
        beyond = distance + 0.5 * self.resolution
        beside = BEAMS_THROUGH // 2
        padded = np.pad(scan.ranges, beside, mode="edge")
        nearest = np.clip(beam, 0, len(scan.ranges) - 1)
        count = np.zeros(distance.shape, np.int64)
        for offset in range(BEAMS_THROUGH):
            count += padded[nearest + offset] > beyond
        count[~seen] = 0
        return count == BEAMS_THROUGH, count

    def _end_in_cells(self, scan: Scan) -> NDArray[np.int64]:
        """Count the beams [H, W] that end in each cell, and update the places of hits."""
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
        hits[flat] = np.minimum(total, MAX_HITS)
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
    """Return the part of `size` cells that stays in a window after a shift."""
    return slice(max(shift, 0), size + min(shift, 0))
