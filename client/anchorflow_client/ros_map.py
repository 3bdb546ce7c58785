"""Read ROS maps: the YAML file and picture of a map_server, as a grid in the contract's frame.

    ros_map = load_ros_map("map.yaml")
    seen = map_window(ros_map, start, goal)
    client.plan(cost_map=seen.occupancy, resolution=seen.resolution, origin=seen.origin, ...)

A picture's top row has the largest y; the rows of a `RosMap` grow with y, as in an OccupancyGrid.
The modes follow nav2's map_server
(https://github.com/ros-navigation/navigation2/tree/main/nav2_map_server), except that a pixel that
is not opaque is unknown in every mode. Needs PyYAML and Pillow, which the client does not install.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from anchorflow_client.contract.fields import (
    COORDINATE,
    MAX_MAP_CELLS,
    MIN_MAP_CELLS,
    RESOLUTION,
)
from anchorflow_client.errors import AnchorFlowError


class RosMapError(AnchorFlowError):
    """A map cannot be read; the message names the file, the field, and what was expected."""


class WindowError(AnchorFlowError):
    """No window of the map can hold start and goal."""


MARGIN_M = 3.0
"""Room for a detour beyond start and goal, on each side."""


@dataclass(frozen=True)
class RosMap:
    """An occupancy grid in the map frame."""

    occupancy: NDArray[np.float32]  # [H, W] in [0, 1]; row 0 has the smallest y
    unknown: NDArray[np.bool_]  # [H, W]; their occupancy is unknown_occupancy
    resolution: float  # m/cell
    origin: NDArray[np.float64]  # [2] m, the outer corner of cell (0, 0)
    unknown_occupancy: float  # 1 where unknown space counts as occupied, 0 where it counts as free

    def crop(self, center: NDArray[np.float64], size_m: float) -> RosMap:
        """Cut a square window round `center` [2] (m), `size_m` wide, rounded up to whole cells.

        Cells beyond the map are unknown.
        """
        cells = math.ceil(size_m / self.resolution - 1e-9)  # 6.4 / 0.05 is 128
        corner = (np.asarray(center) - self.origin) / self.resolution - cells / 2
        column, row = (int(index) for index in np.rint(corner))
        return RosMap(
            occupancy=_window(self.occupancy, row, column, cells, fill=self.unknown_occupancy),
            unknown=_window(self.unknown, row, column, cells, fill=True),
            resolution=self.resolution,
            origin=self.origin + self.resolution * np.array([column, row]),
            unknown_occupancy=self.unknown_occupancy,
        )


def load_ros_map(path: Path | str, *, unknown_is_free: bool = False) -> RosMap:
    """Read a map_server YAML file and its .pgm or .png picture.

    Raises `RosMapError` if a file is missing or no map, or a field is missing or out of range.
    """
    path = Path(path)
    fields = _Fields(path, _read_yaml(path))
    image = path.parent / fields.text("image")
    mode = fields.choice("mode", tuple(_OCCUPANCY_OF_MODE), default="trinary")
    thresholds = _Thresholds(
        free=fields.number("free_thresh", low=0, high=1),
        occupied=fields.number("occupied_thresh", low=0, high=1),
    )
    if thresholds.free >= thresholds.occupied:
        raise fields.error("free_thresh", "less than occupied_thresh", thresholds.free)
    negate = fields.choice("negate", (0, 1), default=0)

    shade, opaque = _read_shade(image)
    if mode != "raw" and not negate:
        shade = 1 - shade  # dark is occupied
    occupancy = np.where(opaque, _OCCUPANCY_OF_MODE[mode](shade, thresholds), np.nan)[::-1]
    unknown = np.isnan(occupancy)
    unknown_occupancy = 0.0 if unknown_is_free else 1.0
    return RosMap(
        occupancy=np.where(unknown, unknown_occupancy, occupancy).astype(np.float32),
        unknown=unknown,
        resolution=fields.number("resolution", low=RESOLUTION.low, high=RESOLUTION.high),
        origin=_origin(fields),
        unknown_occupancy=unknown_occupancy,
    )


def map_window(
    ros_map: RosMap,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    *,
    size_m: float | None = None,
    option: str = "size_m",
) -> RosMap:
    """Cut a square window centred between `start` and `goal` ([2] m each).

    size_m: its side; by default the distance with MARGIN_M at both ends
    option: name of `size_m` in error messages

    Raises `WindowError` if the window would miss an end, or have more cells than a request allows.
    """
    extent_m = float(np.abs(goal - start).max())
    if size_m is None:
        size_m = float(np.linalg.norm(goal - start)) + 2 * MARGIN_M
    elif not size_m > extent_m:
        raise WindowError(
            f"{option}: expected more than {extent_m:g} m, to hold start and goal, got {size_m:g}"
        )
    size_m = max(size_m, MIN_MAP_CELLS * ros_map.resolution)
    limit_m = MAX_MAP_CELLS * ros_map.resolution
    if size_m > limit_m:
        raise WindowError(
            f"expected a window of at most {limit_m:g} m ({MAX_MAP_CELLS} cells of "
            f"{ros_map.resolution:g} m), got {size_m:g} m; bring start and goal nearer together "
            f"or choose a smaller {option}"
        )
    return ros_map.crop((start + goal) / 2, size_m)


@dataclass(frozen=True)
class _Thresholds:
    free: float
    occupied: float


def _trinary(darkness: NDArray[np.float64], thresholds: _Thresholds) -> NDArray[np.float64]:
    """Return 0 for free, 1 for occupied, NaN (unknown) between the thresholds."""
    between = np.where(darkness < thresholds.free, 0.0, np.nan)
    return np.where(darkness > thresholds.occupied, 1.0, between)


def _scale(darkness: NDArray[np.float64], thresholds: _Thresholds) -> NDArray[np.float64]:
    """Return occupancy linear between the thresholds."""
    span = thresholds.occupied - thresholds.free
    return np.clip((darkness - thresholds.free) / span, 0.0, 1.0)


def _raw(shade: NDArray[np.float64], _: _Thresholds) -> NDArray[np.float64]:
    """Return the pixel value as percent; above 100 it is NaN (unknown)."""
    percent = np.rint(255 * shade)
    return np.where(percent <= 100, percent / 100, np.nan)


_OCCUPANCY_OF_MODE: dict[str, Callable[[NDArray[np.float64], _Thresholds], NDArray[np.float64]]] = {
    "trinary": _trinary,
    "scale": _scale,
    "raw": _raw,
}


@dataclass(frozen=True)
class _Fields:
    """Reads and checks the fields of the YAML file."""

    path: Path
    values: dict[str, Any]

    def error(self, name: str, expected: str, came: object) -> RosMapError:
        return RosMapError(f"{self.path}: {name}: expected {expected}, got {came!r}")

    def text(self, name: str) -> str:
        value = self.values.get(name)
        if not isinstance(value, str):
            raise self.error(name, "a file name", value)
        return value

    def number(self, name: str, *, low: float, high: float) -> float:
        value = self.values.get(name)
        if not _is_number(value) or not low <= value <= high:
            raise self.error(name, f"a number from {low:g} to {high:g}", value)
        return float(value)

    def choice(self, name: str, choices: tuple[Any, ...], *, default: Any) -> Any:
        value = self.values.get(name, default)
        if value not in choices:
            raise self.error(name, f"one of {', '.join(map(str, choices))}", value)
        return value


def _is_number(value: object) -> TypeGuard[float]:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return -math.inf < value < math.inf  # math.isfinite fails for huge integers


def _origin(fields: _Fields) -> NDArray[np.float64]:
    origin = fields.values.get("origin")
    if not isinstance(origin, list) or len(origin) != 3 or not all(map(_is_number, origin)):
        raise fields.error("origin", "three numbers x, y, yaw", origin)
    if origin[2] != 0:
        raise fields.error("origin", "a yaw of 0 (turned maps are not supported)", origin[2])
    if not all(map(COORDINATE.holds, origin)):
        raise fields.error("origin", f"numbers {COORDINATE}", origin)
    return np.array(origin[:2], dtype=np.float64)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        said = " ".join(str(error).split())
        raise RosMapError(f"{path}: expected a map_server YAML file: {said}") from error
    if not isinstance(values, dict):
        raise RosMapError(f"{path}: expected a map_server YAML file with named fields")
    return values


def _read_shade(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the mean colour [H, W] in [0, 1], top row first, and whether each pixel is opaque."""
    try:
        with Image.open(path) as image:
            if image.mode.startswith("I"):  # 16 bits a pixel
                shade = np.asarray(image, dtype=np.float64) / 65535
                return shade, np.ones(shade.shape, dtype=np.bool_)
            channels = np.asarray(image.convert("RGBA"), dtype=np.float64) / 255
    # Pillow raises the first three for a damaged file.
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise RosMapError(f"{path}: image: expected a .pgm or .png picture: {error}") from error
    return channels[..., :3].mean(axis=-1), channels[..., 3] == 1


def _window(grid: NDArray[Any], row: int, column: int, cells: int, *, fill: Any) -> NDArray[Any]:
    """Return `cells` × `cells` of `grid` from (row, column), `fill` outside the grid."""
    window = np.full((cells, cells), fill, dtype=grid.dtype)
    height, width = grid.shape
    bottom, top = np.clip([row, row + cells], 0, height)
    left, right = np.clip([column, column + cells], 0, width)
    window[bottom - row : top - row, left - column : right - column] = grid[bottom:top, left:right]
    return window
