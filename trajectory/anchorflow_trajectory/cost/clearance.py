"""Clearance: the distance from the robot's edge to the nearest occupied cell.

Near the map's edge it is at most the distance of the robot's centre to that edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.caching import MapCache, cached_property
from anchorflow_trajectory.compiled import compiled, compiled_part

OCCUPIED = 0.5  # occupancy from which a cell is an obstacle
FINE, ROUNDING = 0.15, 1e-6  # m, the largest cells that are not cut, and in parts of a cell
FINE_AMONG = 0.1  # m, the same where something moves among walls and a way round is late
MOST_CELLS = 512  # a side of a map whose cells were cut
# Successive requests often share a map, with other starts and other robots.
SHARED = MapCache(most_bytes=32 << 20)


def distance_to_cells(cells: BoolArray, resolution: float) -> FloatArray:
    """Return the distance [m] of each cell's centre to the nearest set cell's *square*: [H, W].

    A distance to its centre would overstate clearance by half a cell. Infinite if no cell is set.
    """
    return (distance_in_cells(np.ascontiguousarray(cells)) * resolution).astype(np.float32)


def clearance_field(occupied: BoolArray, resolution: float, robot_radius: float) -> FloatArray:
    """Clearance [m] at cell centres [H, W]: negative where the robot's disc touches an obstacle.

    The robot's centre must also stay on the map, so the distance to the map's edge is a bound too.
    Inside obstacles the field keeps falling, so that its gradient points out of them.
    """
    signed = SHARED.of(occupied, resolution, signed_distance)
    height, width = occupied.shape
    to_edge = [
        np.minimum(i, n - 1 - i) + 0.5
        for n, i in ((height, np.arange(height)), (width, np.arange(width)))
    ]
    edge = np.minimum(to_edge[0][:, None], to_edge[1]) * resolution
    return np.minimum(signed - robot_radius, edge).astype(np.float32)


def signed_distance(occupied: BoolArray, resolution: float) -> FloatArray:
    """Distance [m] to obstacles [H, W], less the distance to free ground inside of them."""
    inside = distance_to_cells(~occupied, resolution)
    inside[~np.isfinite(inside)] = max(occupied.shape) * resolution
    return distance_to_cells(occupied, resolution) - inside


@dataclass(frozen=True)
class GridField:
    """A scalar field on cell centres, interpolated bilinearly.

    values: [H, W], row index grows with y; origin: [2] m, outer corner of cell (0, 0).
    Beyond the outermost centres the field falls by one metre a metre, as a clearance does there.
    """

    values: FloatArray
    resolution: float
    origin: FloatArray

    @cached_property
    def made(self) -> dict[Any, Any]:
        """Return the cache of `Grid`s for compiled loops, by dtype."""
        return {}

    @cached_property
    def _coefficients(self) -> FloatArray:
        """[H*W, 4]: value, x slope, y slope and twist of each patch, so a lookup is one gather."""
        field = np.pad(self.values, ((0, 1), (0, 1)), mode="edge")
        corner, right, up = field[:-1, :-1], field[:-1, 1:], field[1:, :-1]
        twist = field[1:, 1:] - right - up + corner
        return np.stack([corner, right - corner, up - corner, twist], -1).reshape(-1, 4)

    def _patch(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
        """Coefficients [..., 4], the place inside the patch and the overshoot, all in cells."""
        height, width = self.values.shape
        scale = np.float32(1.0 / self.resolution)
        u = x * scale - np.float32(self.origin[0] / self.resolution + 0.5)
        v = y * scale - np.float32(self.origin[1] / self.resolution + 0.5)
        inside_u = np.clip(u, 0, width - 1)
        inside_v = np.clip(v, 0, height - 1)
        column, row = np.floor(inside_u), np.floor(inside_v)
        # A float32 counts cells exactly up to 2^24 of them, and stays half as wide as an index.
        patch = np.take(self._coefficients, (row * width + column).astype(np.intp), axis=0)
        return patch, inside_u - column, inside_v - row, u - inside_u, v - inside_v

    def sample(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Values at points (x, y) in m, any shape."""
        patch, fu, fv, over_u, over_v = self._patch(x, y)
        value = patch[..., 0] + patch[..., 1] * fu + (patch[..., 2] + patch[..., 3] * fu) * fv
        return value - (np.abs(over_u) + np.abs(over_v)) * np.float32(self.resolution)

    def sample_with_gradient(
        self, x: FloatArray, y: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values and their derivatives along x and y [1/m] at points (x, y) in m, any shape."""
        patch, fu, fv, over_u, over_v = self._patch(x, y)
        scale = np.float32(1.0 / self.resolution)
        slope_u = patch[..., 1] + patch[..., 3] * fv
        slope_v = patch[..., 2] + patch[..., 3] * fu
        value = patch[..., 0] + slope_u * fu + patch[..., 2] * fv
        value -= (np.abs(over_u) + np.abs(over_v)) * np.float32(self.resolution)
        along_x = np.where(over_u == 0, slope_u * scale, -np.sign(over_u))
        along_y = np.where(over_v == 0, slope_v * scale, -np.sign(over_v))
        return value, along_x, along_y


@compiled
def distance_in_cells(cells: BoolArray) -> NDArray[np.float64]:
    """Distance [H, W] from every cell's centre to the *square* of the nearest set cell.

    The nearest by its centre; of several the one with the least row of its column, and of those the
    first by column. Infinite where no cell is set.
    """
    height, width = cells.shape
    apart = _along_columns(cells)
    distance = np.full((height, width), np.inf)
    # The envelope's parabolas: the column of each one's tip, and the first at which it is lowest.
    tips, begins = np.empty(width, np.int64), np.empty(width, np.int64)
    for row in range(height):
        count = 0
        for column in range(width):
            if apart[row, column] < 0:
                continue
            begin = 0
            while count:
                tip = tips[count - 1]
                rise = apart[row, column] ** 2 - apart[row, tip] ** 2 + column**2 - tip**2
                # Where both are as low, the left one stays.
                begin = rise // (2 * (column - tip)) + 1
                if begin > begins[count - 1]:
                    break
                count, begin = count - 1, 0
            if begin < width:
                tips[count], begins[count] = column, begin
                count += 1
        if not count:
            continue
        at = 0
        for column in range(width):
            while at + 1 < count and begins[at + 1] <= column:
                at += 1
            down = max(apart[row, tips[at]] - 0.5, 0.0)
            across = max(abs(column - tips[at]) - 0.5, 0.0)
            distance[row, column] = np.sqrt(down * down + across * across)
    return distance


@compiled_part
def _along_columns(cells: BoolArray) -> NDArray[np.int64]:
    """Cells [H, W] to the nearest set cell of the same column; -1 where it has none."""
    height, width = cells.shape
    apart = np.full((height, width), -1, np.int64)
    for row in range(height):
        for column in range(width):
            if cells[row, column]:
                apart[row, column] = 0
            elif row and apart[row - 1, column] >= 0:
                apart[row, column] = apart[row - 1, column] + 1
    for row in range(height - 2, -1, -1):
        for column in range(width):
            below = apart[row + 1, column]
            if below >= 0 and (apart[row, column] < 0 or below + 1 < apart[row, column]):
                apart[row, column] = below + 1
    return apart


def finer_cells(
    cost_map: FloatArray, resolution: float, fine: float = FINE
) -> tuple[FloatArray, float]:
    """Cut cells of a map [..., H, W] larger than `fine` m; return it and its resolution [m].

    A certified clearance keeps a share of a cell in reserve, which closes ways that are one or two
    coarse cells wide.
    """
    parts = min(math.ceil(resolution / fine - ROUNDING), MOST_CELLS // max(cost_map.shape[-2:]))
    if parts <= 1:
        return cost_map, resolution
    return cost_map.repeat(parts, -2).repeat(parts, -1), resolution / parts
