"""The cost map: a grid of costs around the robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.checks import (
    array_of_bytes,
    fields_of,
    frozen,
    number,
    numbers,
    read_only,
    unshared,
    within,
    wrong_shape,
)
from anchorflow_client.contract.fields import (
    CHANNEL_WEIGHT,
    COORDINATE,
    COST_MAP,
    MAX_CHANNELS,
    MAX_MAP_CELLS,
    MIN_MAP_CELLS,
    RESOLUTION,
    UNIT,
)
from anchorflow_client.contract.hints import map_hint, map_shape_hint
from anchorflow_client.contract.ros_grid import RosGrid, Unknown, values_of
from anchorflow_client.errors import InvalidRequest

MAP_SHAPE = "[C,H,W] or [B,C,H,W]"


@dataclass(frozen=True, eq=False)
class CostMap:
    """A grid of costs; row index grows with y, column index with x (ROS OccupancyGrid order).

    Channel 0 is obstacle occupancy, 1 traversability, 2 risk, 3 and further other soft costs.
    """

    data: NDArray[np.float32]
    """[B,C,H,W] in [0, 1]; [C,H,W] if it is not part of a request."""
    resolution: float
    """m/cell."""
    origin: NDArray[np.float64]
    """[2] m, outer corner of cell (0, 0)."""
    channel_weights: NDArray[np.float64] | None = None
    """[C-1] factors of the soft costs of channels 1 to C - 1; None: 1 each."""

    @classmethod
    def build(
        cls, data: Any, resolution: Any, origin: Any = None, channel_weights: Any = None
    ) -> CostMap:
        """Check and convert the fields of the JSON contract.

        Args:
            data: [C,H,W] or [B,C,H,W] in [0, 1]; a numpy array of bool is an occupancy grid.
            resolution: m/cell, from 1e-6.
            origin: [2] m; None centres the map on (0, 0).
            channel_weights: [C-1], from 0 to 100; None: 1 each.

        Raises:
            InvalidRequest: names the field, such as cost_map.data.
        """
        grid = _grid(data)
        cell = number(resolution, "cost_map.resolution", RESOLUTION)
        corner = read_only(_corner(origin, grid.shape, cell))
        return cls(read_only(grid), cell, corner, _weights(channel_weights, grid.shape[-3]))

    @classmethod
    def from_fields(cls, value: Any) -> CostMap:
        """Check the JSON object, or another CostMap again."""
        if isinstance(value, CostMap):
            return cls.build(**vars(value))
        known, required = COST_MAP.fields, COST_MAP.required_fields
        return cls.build(**fields_of(value, "cost_map", known, required))

    @classmethod
    def from_nav2(
        cls,
        costs: ArrayLike | RosGrid | Any,
        resolution: float | None = None,
        origin: ArrayLike | None = None,
        *,
        inscribed_is_obstacle: bool = False,
        unknown: Unknown = "obstacle",
        center: ArrayLike | None = None,
        size_m: float | None = None,
    ) -> CostMap:
        """Convert Nav2's costs: 254 is an obstacle, 1 to 253 are soft costs, the risk.

        Args:
            costs: [H,W] from 0 to 255, row 0 at the lowest y; or a nav2_msgs/Costmap.
            resolution: m/cell, with an array.
            origin: [2] m, outer corner of cell (0, 0), with an array; None centres it on (0, 0).
            inscribed_is_obstacle: take 253 as an obstacle too, for a robot of radius 0.
            unknown: what 255 counts as: "obstacle", "free" or a soft cost in [0, 1].
            center: [2] m, the middle of a square window, for grids of more than 512 cells a side.
            size_m: side of that window in m; what lies beyond the grid is unknown.

        Raises:
            InvalidRequest: names the argument, what was expected and what came.
        """
        grid = _ros_grid(costs, resolution, origin, raw=True)
        return cls._of_grid(
            grid,
            center,
            size_m,
            inscribed_is_obstacle=inscribed_is_obstacle,
            unknown=unknown,
        )

    @classmethod
    def from_occupancy_grid(
        cls,
        grid: ArrayLike | RosGrid | Any,
        resolution: float | None = None,
        origin: ArrayLike | None = None,
        *,
        inflated: bool = True,
        inscribed_is_obstacle: bool = False,
        unknown: Unknown = "obstacle",
        center: ArrayLike | None = None,
        size_m: float | None = None,
    ) -> CostMap:
        """Convert an OccupancyGrid, such as Nav2's `/global_costmap/costmap` or a map.

        Args:
            grid: a nav_msgs/OccupancyGrid, or its values [H,W] from -1 to 100.
            inflated: True for a cost map, and for a map of free and occupied cells: 100 is an
                obstacle, 1 to 99 are soft costs, the risk. False for probabilities, as SLAM
                publishes them: from 65 on a cell is an obstacle, below that the risk is its share.
            inscribed_is_obstacle: take 99 of a cost map as an obstacle, for a robot of radius 0.
            unknown: what -1 counts as: "obstacle", "free" or a soft cost in [0, 1].
            resolution, origin, center, size_m: as in `from_nav2`.

        Raises:
            InvalidRequest: names the argument, what was expected and what came.
        """
        return cls._of_grid(
            _ros_grid(grid, resolution, origin, raw=False),
            center,
            size_m,
            inflated=inflated,
            inscribed_is_obstacle=inscribed_is_obstacle,
            unknown=unknown,
        )

    @classmethod
    def _of_grid(
        cls, grid: RosGrid, center: ArrayLike | None, size_m: float | None, **meaning: Any
    ) -> CostMap:
        if (center is None) != (size_m is None):
            raise InvalidRequest(
                "expected both center and size_m of a window, or neither", "size_m"
            )
        if center is not None and size_m is not None:
            grid = grid.crop(center, size_m)
        return cls.build(grid.layers(**meaning), grid.resolution, grid.origin)

    @property
    def occupancy(self) -> NDArray[np.float32]:
        """[B,H,W] (or [H,W]), channel 0."""
        return self.data[..., 0, :, :]

    @property
    def extent(self) -> NDArray[np.float64]:
        """[2,2] m: the lower and the upper corner (x, y) of the map."""
        return np.array(self._bounds).reshape(2, 2)

    def contains(self, x: float, y: float) -> bool:
        """Return whether a point in m is on the map, border included."""
        x_low, y_low, x_high, y_high = self._bounds
        return x_low <= x <= x_high and y_low <= y <= y_high

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """Return (row, column) of the cell at a point in m, or of the nearest cell to it."""
        x_low, y_low, x_high, y_high = self._bounds
        height, width = self.data.shape[-2:]
        column = (min(max(x, x_low), x_high) - x_low) / self.resolution
        row = (min(max(y, y_low), y_high) - y_low) / self.resolution
        return min(int(row), height - 1), min(int(column), width - 1)

    @property
    def _bounds(self) -> tuple[float, float, float, float]:
        """x and y of the lower corner in m, then of the upper one."""
        (x, y), (height, width) = self.origin.tolist(), self.data.shape[-2:]
        return x, y, x + self.resolution * width, y + self.resolution * height


def _grid(data: Any) -> NDArray[np.float32]:
    field = "cost_map.data"
    if isinstance(data, dict):
        if "png" in data:
            came = "got a PNG, which a service decodes only in JSON requests"
            raise InvalidRequest(f"expected numbers of shape {MAP_SHAPE}, {came}", f"{field}.png")
        data = array_of_bytes(data, field)
    if isinstance(data, np.ndarray):
        data = np.asarray(data)  # a masked array has numbers under its mask too
    if isinstance(data, np.ndarray) and data.dtype == np.bool_:
        data = frozen(data.astype(np.float32))
    if isinstance(data, np.ndarray) and data.dtype == np.float32:
        # Views of the request's bytes are kept without a copy, as they are read-only.
        grid = within(unshared(data), field, UNIT, hint=map_hint)
    else:
        grid = frozen(numbers(data, field, UNIT, MAP_SHAPE, hint=map_hint).astype(np.float32))
    hint = map_shape_hint(grid.shape)
    if grid.ndim not in (3, 4):
        raise wrong_shape(field, MAP_SHAPE, grid, hint)
    channels, *sides = grid.shape[-3:]
    if not 1 <= channels <= MAX_CHANNELS:
        raise InvalidRequest(f"expected C from 1 to {MAX_CHANNELS}, got {channels}{hint}", field)
    if not all(MIN_MAP_CELLS <= side <= MAX_MAP_CELLS for side in sides):
        limits = f"from {MIN_MAP_CELLS} to {MAX_MAP_CELLS}"
        raise InvalidRequest(f"expected H and W {limits}, got {sides[0]} and {sides[1]}", field)
    return grid


def _corner(origin: Any, shape: tuple[int, ...], resolution: float) -> NDArray[np.float64]:
    if origin is None:
        return -0.5 * resolution * np.array([shape[-1], shape[-2]], dtype=np.float64)
    corner = numbers(origin, "cost_map.origin", COORDINATE, "[2]")
    if corner.shape != (2,):
        raise wrong_shape("cost_map.origin", "[2]", corner)
    return corner


def _weights(weights: Any, channels: int) -> NDArray[np.float64] | None:
    if weights is None:
        return None
    field, shape = (
        "cost_map.channel_weights",
        f"[{channels - 1}], one for each channel but the first",
    )
    factors = numbers(weights, field, CHANNEL_WEIGHT, shape)
    if factors.shape != (channels - 1,):
        raise wrong_shape(field, shape, factors)
    return frozen(factors) if factors.size else None


def _ros_grid(grid: Any, resolution: Any, origin: Any, *, raw: bool) -> RosGrid:
    """Read a message, or an array beside its resolution and origin."""
    if isinstance(grid, RosGrid) or hasattr(grid, "info") or hasattr(grid, "metadata"):
        if resolution is not None or origin is not None:
            raise InvalidRequest("expected none, as the grid has its own", "resolution")
        grid = grid if isinstance(grid, RosGrid) else RosGrid.of(grid)
        if (grid.values.dtype == np.uint8) != raw:
            names = ("an OccupancyGrid", "a nav2_msgs/Costmap")
            raise InvalidRequest(f"expected {names[raw]}, got {names[not raw]}", "grid")
        return grid
    values = values_of(grid, raw=raw)
    cell = number(resolution, "resolution", RESOLUTION)
    return RosGrid(values=values, resolution=cell, origin=_corner(origin, values.shape, cell))
