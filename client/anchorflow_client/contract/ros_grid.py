"""Grids that ROS publishes, their updates, and the layers of a cost map that they become.

    seen = RosGrid.of(message)      # nav_msgs/OccupancyGrid or nav2_msgs/Costmap
    seen = seen.updated(update)     # from /costmap_updates, for the grid that it was made for
    cost_map = CostMap.from_occupancy_grid(seen)

Needs numpy alone: messages are any objects with the fields of the ROS types.

Nav2's costs are 0 (free), 1 to 252 (inflated), 253 (the robot's centre may not be here), 254 (an
obstacle) and 255 (unknown). As an OccupancyGrid it publishes 0, 1 to 98, 99, 100 and -1 for them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.checks import as_array, expected, first_refused, is_number, number
from anchorflow_client.contract.fields import COORDINATE, RESOLUTION, UNIT
from anchorflow_client.errors import InvalidRequest

Unknown: TypeAlias = Literal["obstacle", "free"] | float
"""What unknown space counts as: an obstacle, free, or the soft cost of that number in [0, 1]."""

INFLATED, INSCRIBED, LETHAL, UNKNOWN = 252, 253, 254, 255
"""Nav2's costs: the highest of inflation, and the three special ones."""
Grid = TypeVar("Grid", bound="RosGrid")
OCCUPIED_PERCENT = 65
"""Probability from which on map_server and map_saver take a cell as occupied."""
MAX_YAW = 1e-9
"""rad, of a map that counts as not turned: what savers write as 0 may be -3e-17."""
INSCRIBED_PERCENT, LETHAL_PERCENT = 99, 100
"""What the special costs are in an OccupancyGrid."""


class Cells(Protocol):
    """The values of a grid: an array, or what reads them window by window."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W)."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """int8 or uint8."""
        ...

    def __getitem__(self, window: tuple[slice, slice], /) -> NDArray[Any]:
        """Return the values of some rows and columns."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class RosGrid:
    """A grid in the frame of its map; rows grow with y, columns with x."""

    values: Cells
    """[H,W]: int8 are percent or -1, as in an OccupancyGrid; uint8 are Nav2's costs."""
    resolution: float
    """m/cell."""
    origin: NDArray[np.float64]
    """[2] m, outer corner of cell (0, 0)."""
    frame_id: str | None = None
    stamp: float | None = None
    """s, of the grid or of its last update."""

    @classmethod
    def of(cls, message: Any) -> RosGrid:
        """Read a nav_msgs/OccupancyGrid or nav2_msgs/Costmap. Raises `InvalidRequest`."""
        if is_raw := hasattr(message, "metadata"):
            about = message.metadata
            height, width = about.size_y, about.size_x
        else:
            about = message.info
            height, width = about.height, about.width
        pose = about.origin
        frame_id, stamp = _header(message)
        return cls(
            values=values_of(message.data, raw=is_raw, shape=(int(height), int(width))),
            resolution=number(float(about.resolution), "resolution", RESOLUTION),
            origin=_corner([pose.position.x, pose.position.y], pose.orientation),
            frame_id=frame_id,
            stamp=stamp,
        )

    def updated(self, update: Any) -> RosGrid:
        """Return the grid with a map_msgs/OccupancyGridUpdate or nav2_msgs/CostmapUpdate in it.

        An update holds no origin and counts in cells of the grid that was published before it.

        Raises:
            InvalidRequest: it has another frame, is older than the grid, or does not fit into it.
        """
        frame_id, stamp = _header(update)
        if None not in (frame_id, self.frame_id) and frame_id != self.frame_id:
            raise InvalidRequest(f"expected {self.frame_id}, got {frame_id}", "update.frame_id")
        if stamp is not None and self.stamp is not None and stamp < self.stamp:
            message = f"expected an update of this grid, of {self.stamp:.9f} s or later"
            raise InvalidRequest(f"{message}, got one of {stamp:.9f} s", "update.stamp")
        is_raw = hasattr(update, "size_x")
        if is_raw != (self.values.dtype == np.uint8):
            kinds = ("an OccupancyGridUpdate", "a CostmapUpdate")
            raise InvalidRequest(f"expected {kinds[not is_raw]}, got {kinds[is_raw]}", "update")
        height, width = (update.size_y, update.size_x) if is_raw else (update.height, update.width)
        row, column, height, width = map(int, (update.y, update.x, height, width))
        rows, columns = self.values.shape
        if row + height > rows or column + width > columns or min(row, column) < 0:
            area = f"columns {column} to {column + width} and rows {row} to {row + height}"
            raise InvalidRequest(
                f"expected an area of this grid of {columns} by {rows} cells, got {area}", "update"
            )
        values = self.values[:, :].copy()
        values[row : row + height, column : column + width] = values_of(
            update.data, raw=is_raw, shape=(height, width)
        )
        return replace(self, values=values, stamp=self.stamp if stamp is None else stamp)

    def crop(self: Grid, center: ArrayLike, size_m: float) -> Grid:
        """Cut a square window round `center` [2] (m), `size_m` wide, rounded up to whole cells.

        Cells beyond the grid are unknown.
        """
        cells = math.ceil(size_m / self.resolution - 1e-9)  # 6.4 / 0.05 is 128
        corner = (np.asarray(center, np.float64) - self.origin) / self.resolution - cells / 2
        column, row = (int(index) for index in np.rint(corner))
        return replace(
            self,
            values=_window(self.values, row, column, cells),
            origin=self.origin + self.resolution * np.array([column, row]),
        )

    def layers(
        self, *, inflated: bool = True, inscribed_is_obstacle: bool = False, unknown: Unknown
    ) -> NDArray[np.float32]:
        """Return [3,H,W] in [0, 1]: obstacles, traversability 1, and the soft costs as risk.

        See `CostMap.from_occupancy_grid` for the arguments.
        """
        if not (unknown in ("obstacle", "free") or (is_number(unknown) and UNIT.holds(unknown))):
            raise expected("unknown", '"obstacle", "free" or a soft cost in [0, 1]', unknown)
        is_raw = self.values.dtype == np.uint8
        soft = (_costs if is_raw else _published_costs if inflated else _percent)()
        table = np.ones((3, 256), np.float32)
        table[0], table[2] = np.isinf(soft), np.where(np.isfinite(soft), soft, 0.0)
        if inscribed_is_obstacle and (is_raw or inflated):
            inscribed = INSCRIBED if is_raw else INSCRIBED_PERCENT
            table[0, inscribed], table[2, inscribed] = 1.0, 0.0
        table[0, UNKNOWN] = unknown == "obstacle"  # -1 in int8 is 255 in uint8
        table[2, UNKNOWN] = 0.0 if isinstance(unknown, str) else unknown
        return table[:, self.values[:, :].view(np.uint8)]


def values_of(data: Any, *, raw: bool, shape: tuple[int, int] | None = None) -> NDArray[Any]:
    """Return the values [H,W] of a message, a list or an array: uint8 if `raw`, else int8.

    Raises:
        InvalidRequest: they do not fit the shape, or are no costs.
    """
    values = as_array(data, "data")
    if values.dtype.kind not in "iu":
        raise expected("data", "whole numbers", values)
    if shape is None and values.ndim != 2:
        raise InvalidRequest(f"expected shape [H,W], got {list(values.shape)}", "data")
    if shape is not None:
        if values.size != shape[0] * shape[1]:
            cells = f"{shape[0]} rows of {shape[1]} cells"
            raise InvalidRequest(f"expected {cells}, got {values.size} cells", "data")
        values = values.reshape(shape)
    low, high = (0, UNKNOWN) if raw else (-1, LETHAL_PERCENT)
    if values.size and not low <= values.min() <= values.max() <= high:
        outside = (values < low) | (values > high)
        raise first_refused(values, outside, "data", f"numbers from {low} to {high}")
    return values.astype(np.uint8 if raw else np.int8)


@cache
def _costs() -> NDArray[np.float64]:
    """Return the soft cost of each of Nav2's costs, infinite for an obstacle."""
    soft = np.arange(256) / INSCRIBED
    soft[LETHAL] = np.inf
    return soft


@cache
def _published_costs() -> NDArray[np.float64]:
    """Return the soft cost of each value of a published cost map, infinite for an obstacle."""
    soft = np.zeros(256)
    published = np.arange(1, INSCRIBED_PERCENT)
    soft[published] = (1 + (published - 1) * (INFLATED - 1) / (len(published) - 1)) / INSCRIBED
    soft[INSCRIBED_PERCENT], soft[LETHAL_PERCENT] = 1.0, np.inf
    return soft


@cache
def _percent() -> NDArray[np.float64]:
    """Return the soft cost of each probability in percent, infinite for an obstacle."""
    percent = np.arange(256)
    return np.where(percent < OCCUPIED_PERCENT, percent / 100, np.inf)


def _header(message: Any) -> tuple[str | None, float | None]:
    header = getattr(message, "header", None)
    stamp = getattr(header, "stamp", None)
    seconds = None if stamp is None else stamp.sec + 1e-9 * stamp.nanosec
    return getattr(header, "frame_id", None), seconds


def _corner(position: ArrayLike, orientation: Any) -> NDArray[np.float64]:
    turn = math.hypot(orientation.x, orientation.y, orientation.z)
    if turn > MAX_YAW:
        came = f"[{orientation.x:g}, {orientation.y:g}, {orientation.z:g}, {orientation.w:g}]"
        raise InvalidRequest(f"expected a grid that is not turned, got {came}", "origin")
    corner = np.array(position, np.float64)
    if not COORDINATE.holds_all(corner):
        raise InvalidRequest(f"expected numbers {COORDINATE}, got {corner.tolist()}", "origin")
    return corner


def _window(values: Cells, row: int, column: int, cells: int) -> NDArray[Any]:
    """Return [cells,cells] from (row, column) on; what lies outside the grid is unknown."""
    window = np.full((cells, cells), UNKNOWN, np.uint8).view(values.dtype)
    height, width = values.shape
    bottom, top = np.clip([row, row + cells], 0, height)
    left, right = np.clip([column, column + cells], 0, width)
    window[bottom - row : top - row, left - column : right - column] = values[
        bottom:top, left:right
    ]
    return window
