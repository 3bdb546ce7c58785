"""Cost fields: the maps of one scene, as the cost looks them up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled_part
from anchorflow_trajectory.cost.clearance import OCCUPIED, GridField
from anchorflow_trajectory.movers import MovingDiscs

OCCUPANCY, TRAVERSABILITY, RISK = range(3)  # channels of a cost map; more may follow
ROOM = 12  # numbers of a lane in between
FAINT = 1e-6  # of a soft cost, below which it is none: denormal numbers are slow


@dataclass(frozen=True)
class CostFields:
    """The maps of one scene, and what moves on them.

    clearance: m beyond the robot's radius
    surcharge: m of detour that a metre of way through a place is worth, if any is
    movers: what moves, wider by the robot's radius
    """

    clearance: GridField
    surcharge: GridField | None = None
    movers: MovingDiscs | None = None


def soft_cost(cost_map: FloatArray, weights: FloatArray | None = None) -> NDArray[np.float32]:
    """Return c [H, W] in [0, 1], the soft cost of a map [C, H, W].

    It is the largest of occupancy below that of an obstacle, scaled to [0, 1], of 1 less
    traversability, and of risk and each further channel, these [C - 1] times their weights.
    """
    occupancy = cost_map[OCCUPANCY]
    soft = np.zeros(occupancy.shape, np.float32)
    passable = (occupancy >= FAINT) & (occupancy < OCCUPIED)
    np.divide(occupancy, OCCUPIED, out=soft, where=passable, casting="same_kind")
    for channel in range(TRAVERSABILITY, len(cost_map)):
        layer = cost_map[channel]
        if channel == TRAVERSABILITY:
            layer = 1.0 - layer
        weight = 1.0 if weights is None else weights[channel - 1]
        np.maximum(soft, layer if weight == 1.0 else weight * layer, out=soft)
    soft[soft < FAINT] = 0.0
    return np.minimum(soft, 1.0, out=soft)


class Grid(NamedTuple):
    """A field on cell centres [H, W] as compiled loops read it, numbers of one type.

    first_x, first_y: of cell (0, 0), in cells from the frame's origin
    left, bottom: 0; right, top: W - 1, H - 1. Without a field, values are [0, 0].
    steepest: the most by which the field changes over a metre in any direction
    """

    values: NDArray[np.float32]
    cells_per_m: np.floating
    resolution: np.floating
    first_x: np.floating
    first_y: np.floating
    left: np.floating
    right: np.floating
    bottom: np.floating
    top: np.floating
    steepest: np.floating

    @staticmethod
    def of(field: GridField | None, dtype: DTypeLike) -> Grid:
        """Return the grid of a field, cached by dtype; an empty one for None."""
        if field is None:
            return _nowhere(np.dtype(dtype))
        if (made := field.made.get(dtype)) is None:
            made = field.made[dtype] = Grid._of(field, dtype)
        return made

    @staticmethod
    def _of(field: GridField, dtype: DTypeLike) -> Grid:
        height, width = field.values.shape
        x, y = np.asarray(field.origin) / field.resolution + 0.5
        # Cell positions are rounded to float32 for every dtype, so that all see the same map.
        numbers = np.array([1.0 / field.resolution, field.resolution, x, y], np.float32)
        rise = [np.abs(np.diff(field.values, axis=axis)).max(initial=0.0) for axis in (0, 1)]
        steepest = np.hypot(*np.maximum(np.array(rise) / field.resolution, 1.0))
        bounds = np.array([0.0, width - 1.0, 0.0, height - 1.0, steepest], dtype)
        return Grid(np.ascontiguousarray(field.values, np.float32), *numbers.astype(dtype), *bounds)


@cache
def _nowhere(dtype: np.dtype) -> Grid:
    return Grid(np.zeros((0, 0), np.float32), *np.zeros(9, dtype))


@compiled_part
def look_up(grid: Grid, x: float, y: float) -> tuple[float, float, float]:
    """The value of a field at (x, y) in m and its derivatives along both [1/m].

    As `GridField` does: bilinear, and beyond the outermost centres falling by one metre a metre.
    """
    (row, column, above, after), parts = _cell(grid, x, y)
    values = grid.values
    corners = values[row, column], values[row, after], values[above, column], values[above, after]
    return _between(grid, corners, parts)


@compiled_part
def find_lanes(grid: Grid, x: FloatArray, y: FloatArray, lanes: int, room: FloatArray) -> None:
    """Write in which cells [LANES] places lie, for `read_lanes`.

    room: [ROOM, LANES], for what is written in between; one array, since what may overlap is slow
    """
    for m in range(lanes):
        (row, column, above, after), (right, up, over_u, over_v) = _cell(grid, x[m], y[m])
        room[0, m], room[1, m], room[2, m], room[3, m] = row, column, above, after
        room[4, m], room[5, m], room[6, m], room[7, m] = right, up, over_u, over_v


@compiled_part
def read_lanes(grid: Grid, lanes: int, found: FloatArray, room: FloatArray) -> None:
    """Write what `look_up` says of the places that were found, as [3, LANES].

    These are vectors but for the reading of the cells. Grids of one geometry share a finding.
    """
    for m in range(lanes):
        row, column = np.uint32(room[0, m]), np.uint32(room[1, m])
        above, after = np.uint32(room[2, m]), np.uint32(room[3, m])
        room[8, m], room[9, m] = grid.values[row, column], grid.values[row, after]
        room[10, m], room[11, m] = grid.values[above, column], grid.values[above, after]
    for m in range(lanes):
        corner, right = np.float32(room[8, m]), np.float32(room[9, m])
        up, far = np.float32(room[10, m]), np.float32(room[11, m])
        parts = room[4, m], room[5, m], room[6, m], room[7, m]
        found[0, m], found[1, m], found[2, m] = _between(grid, (corner, right, up, far), parts)


@compiled_part
def are_alike(one: Grid, other: Grid) -> bool:
    """Whether both have the same cells."""
    (rows, columns), (height, width) = one.values.shape, other.values.shape
    return (
        rows == height
        and columns == width
        and one.resolution == other.resolution
        and one.first_x == other.first_x
        and one.first_y == other.first_y
    )


@compiled_part
def _cell(grid: Grid, x: float, y: float) -> tuple[Any, ...]:
    """Row and column of the cells below left and above right of a place, and where it is there.

    That is the shares of the way to the right and up, and how many cells off the outermost centres.
    """
    u, v = x * grid.cells_per_m - grid.first_x, y * grid.cells_per_m - grid.first_y
    # This order of arguments clamps a NaN to the first cell.
    inside_u = min(grid.right, max(grid.left, u))
    inside_v = min(grid.top, max(grid.bottom, v))
    column, row = np.int32(inside_u), np.int32(inside_v)
    after = min(column + np.int32(1), np.int32(grid.right))
    above = min(row + np.int32(1), np.int32(grid.top))
    up, right = inside_v - np.floor(inside_v), inside_u - np.floor(inside_u)
    over_u, over_v = u - inside_u, v - inside_v
    cells = np.uint32(row), np.uint32(column), np.uint32(above), np.uint32(after)
    return cells, (right, up, over_u, over_v)


@compiled_part
def _between(
    grid: Grid, corners: tuple[Any, ...], parts: tuple[Any, ...]
) -> tuple[float, float, float]:
    """Value and slopes among four cells, as `look_up` returns them.

    corners: values below left, below right, above left, above right; parts: as of `_cell`
    """
    corner, right, up, far = corners
    share_u, share_v, over_u, over_v = parts
    twist = far - right - up + corner
    along_u, along_v = right - corner + twist * share_v, up - corner + twist * share_u
    value = corner + along_u * share_u + (up - corner) * share_v
    value -= (abs(over_u) + abs(over_v)) * grid.resolution
    along_x, along_y = along_u * grid.cells_per_m, along_v * grid.cells_per_m
    if over_u != grid.left:
        along_x = -abs(over_u) / over_u
    if over_v != grid.bottom:
        along_y = -abs(over_v) / over_v
    return value, along_x, along_y
