"""The map of a robot's subscriptions: grids and their updates, and the cost map for a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import CostMap
from anchorflow_client.contract.checks import Interval, expected, number
from anchorflow_client.contract.fields import MAX_MAP_CELLS
from anchorflow_client.contract.ros_grid import RosGrid
from anchorflow_client.errors import InvalidRequest

WINDOW = Interval(0.0, 1e6, "m")
STEP_SHARE = 0.1
"""Share of the window that the robot moves before another one is cut."""


@dataclass(frozen=True, kw_only=True)
class MapMeaning:
    """The meaning of a grid's values; see `CostMap.from_occupancy_grid`."""

    inflated: bool = True
    """True: a cost map, in which 100 is an obstacle and less is soft cost. False: probabilities."""
    inscribed_is_obstacle: bool = False
    unknown: str = "obstacle"
    """"obstacle", "free", or a soft cost from 0 to 1."""
    window_m: float = 0.0
    """Side of the window round the robot that is planned on; 0: the whole grid."""

    def __post_init__(self) -> None:
        if self.unknown not in ("obstacle", "free"):
            try:
                cost = float(self.unknown)
            except ValueError:
                cost = math.nan
            if not 0.0 <= cost <= 1.0:
                raise expected(
                    "map.unknown", '"obstacle", "free" or a soft cost in [0, 1]', self.unknown
                )
        number(self.window_m, "map.window_m", WINDOW)


class MapReader:
    """Holds the newest grid with its updates, and cuts the cost map that is planned on.

    A message that is refused leaves the grid as it was.
    """

    def __init__(self, meaning: MapMeaning | None = None) -> None:
        self.meaning = meaning or MapMeaning()
        self.grid: RosGrid | None = None
        self.changed_at = -math.inf
        """s on the caller's clock, at which the last message was accepted."""
        self._cost_map: CostMap | None = None
        self._center: NDArray[np.float64] | None = None

    def reset(self) -> None:
        self.grid = self._cost_map = self._center = None
        self.changed_at = -math.inf

    def on_grid(self, message: Any, *, now: float) -> None:
        """Take a nav_msgs/OccupancyGrid or nav2_msgs/Costmap. Raises `InvalidRequest`."""
        self._take(RosGrid.of(message), now)

    def on_update(self, message: Any, *, now: float) -> None:
        """Put an OccupancyGridUpdate or CostmapUpdate into the grid. Raises `InvalidRequest`."""
        if self.grid is None:
            raise InvalidRequest("expected a whole grid before its updates, got none", "update")
        self._take(self.grid.updated(message), now)

    def cost_map(self, around: NDArray[np.float64]) -> CostMap:
        """Return the cost map of the grid, or of the window round a place [2] in m.

        It is the same object while grid and window are the same. Raises `InvalidRequest` if there
        is no grid yet, or it has more cells than a request allows.
        """
        if self.grid is None:
            raise InvalidRequest("expected a map, got none yet", "map")
        window = self.meaning.window_m
        if self._cost_map is not None and not self._has_left(around, window):
            return self._cost_map
        if not window and max(self.grid.values.shape) > MAX_MAP_CELLS:
            rows, columns = self.grid.values.shape
            raise InvalidRequest(
                f"expected at most {MAX_MAP_CELLS} cells a side without a window, "
                f"got {columns} by {rows}; set map.window_m",
                "map",
            )
        grid = self.grid.crop(around, window) if window else self.grid
        soft = self.meaning.unknown
        layers = grid.layers(
            inflated=self.meaning.inflated,
            inscribed_is_obstacle=self.meaning.inscribed_is_obstacle,
            unknown=soft if soft == "obstacle" or soft == "free" else float(soft),
        )
        self._cost_map = CostMap.build(layers, grid.resolution, grid.origin)
        self._center = np.array(around)
        return self._cost_map

    def _has_left(self, around: NDArray[np.float64], window: float) -> bool:
        if not window or self._center is None:
            return False
        return float(np.abs(around - self._center).max()) > STEP_SHARE * window

    def _take(self, grid: RosGrid, now: float) -> None:
        self.grid, self.changed_at = grid, now
        self._cost_map = self._center = None
