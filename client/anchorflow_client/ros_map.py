"""Read ROS maps: the YAML file and picture of a map_server, as a grid in the contract's frame.

    ros_map = load_ros_map("map.yaml")
    seen = map_window(ros_map, start, goal)
    client.plan(cost_map=seen.occupancy, resolution=seen.resolution, origin=seen.origin, ...)

A picture's top row has the largest y; the rows of a `RosMap` grow with y, as in an OccupancyGrid.
A picture is read when its cells are needed: of a .pgm in bytes the window alone, a .png as a whole.
The modes follow nav2's map_server
(https://github.com/ros-navigation/navigation2/tree/main/nav2_map_server), except that a pixel that
is not opaque is unknown in every mode. Needs PyYAML and Pillow, which the client does not install.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from anchorflow_client.contract.fields import (
    COORDINATE,
    MAX_MAP_CELLS,
    MIN_MAP_CELLS,
    RESOLUTION,
)
from anchorflow_client.contract.hints import place_hint
from anchorflow_client.contract.ros_grid import LETHAL_PERCENT, MAX_YAW, UNKNOWN, RosGrid
from anchorflow_client.errors import AnchorFlowError


class RosMapError(AnchorFlowError):
    """A map cannot be read; the message names the file, the field, and what was expected."""


class WindowError(AnchorFlowError):
    """No window of the map can hold start and goal."""


ROUNDING = 1e-9
"""Cells; 6.4 m in cells of 0.05 m are 128."""

MARGIN_M = 3.0
"""Room for a detour beyond start and goal, on each side."""


MAX_PIXELS = 2**29
"""Of a picture that has to be decoded as a whole: 2 GB with four bytes a pixel."""

KEPT_PIXELS = 2**24
"""Of a picture that is decoded once: 64 MB."""

Grey = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class RosMap(RosGrid):
    """An occupancy grid in the map frame; `values` may be read when they are needed."""

    unknown_occupancy: float = 1.0
    """1 where unknown space counts as occupied, 0 where it counts as free."""

    @cached_property
    def occupancy(self) -> NDArray[np.float32]:
        """[H, W] in [0, 1]: 1 for an obstacle, below 0.5 in proportion to the cost of the rest."""
        table = (np.arange(256) / (2 * LETHAL_PERCENT)).astype(np.float32)
        table[LETHAL_PERCENT], table[UNKNOWN] = 1.0, self.unknown_occupancy
        return table[self.values[:, :].view(np.uint8)]

    @cached_property
    def unknown(self) -> NDArray[np.bool_]:
        """[H, W]; their occupancy is `unknown_occupancy`."""
        return self.values[:, :] < 0

    @property
    def extent(self) -> NDArray[np.float64]:
        """[2,2] m: the lower and the upper corner (x, y)."""
        height, width = self.values.shape
        return np.stack([self.origin, self.origin + self.resolution * np.array([width, height])])

    def coarser(self, factor: int) -> RosMap:
        """Return the map with cells `factor` times as wide, each the dearest of those it covers.

        H and W must be multiples of the factor. An obstacle is dearer than unknown space, which is
        dearer than all else if it counts as occupied, and cheaper otherwise.
        """
        (height, width), step = self.values.shape, int(factor)
        price = 2 * self.values[:, :].astype(np.int16)
        unknown = 2 * LETHAL_PERCENT - 1 if self.unknown_occupancy else -1
        price[self.unknown] = unknown
        dearest = price.reshape(height // step, step, width // step, step).max(axis=(1, 3))
        blocks = np.where(dearest == unknown, -1, dearest // 2)
        return replace(self, values=blocks.astype(np.int8), resolution=step * self.resolution)


def load_ros_map(path: Path | str, *, unknown_is_free: bool = False) -> RosMap:
    """Read a map_server YAML file and the size of its .pgm or .png picture.

    Raises `RosMapError` if a file is missing or no map, or a field is missing or out of range.
    """
    path = Path(path)
    fields = _Fields(path, _read_yaml(path))
    image = path.parent / fields.text("image")
    mode = fields.choice("mode", tuple(_PERCENT_OF_MODE), default="trinary")
    thresholds = _Thresholds(
        free=fields.number("free_thresh", low=0, high=1),
        occupied=fields.number("occupied_thresh", low=0, high=1),
    )
    if thresholds.free >= thresholds.occupied:
        raise fields.error("free_thresh", "less than occupied_thresh", thresholds.free)
    negate = fields.choice("negate", (0, 1), default=0)

    def percent(shade: Grey) -> Grey:
        dark_is_occupied = mode != "raw" and not negate
        return _PERCENT_OF_MODE[mode](1 - shade if dark_is_occupied else shade, thresholds)

    return RosMap(
        values=_PictureCells(image, percent),
        resolution=fields.number("resolution", low=RESOLUTION.low, high=RESOLUTION.high),
        origin=_origin(fields),
        unknown_occupancy=0.0 if unknown_is_free else 1.0,
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

    A window of more cells than a request may have gets wider cells; see `RosMap.coarser`.

    size_m: its side; by default the distance with MARGIN_M at both ends
    option: name of `size_m` in error messages

    Raises `WindowError` if the window would miss an end, or an end is off a map beyond which all
    counts as occupied.
    """
    if ros_map.unknown_occupancy:
        for name, place in (("start", start), ("goal", goal)):
            _check_on_map(ros_map, name, place)
    extent_m = float(np.abs(goal - start).max())
    if size_m is None:
        size_m = float(np.linalg.norm(goal - start)) + 2 * MARGIN_M
    elif not size_m > extent_m:
        raise WindowError(
            f"{option}: expected more than {extent_m:g} m, to hold start and goal, got {size_m:g}"
        )
    size_m = max(size_m, MIN_MAP_CELLS * ros_map.resolution)
    factor = math.ceil(size_m / (MAX_MAP_CELLS * ros_map.resolution) - ROUNDING)
    if factor <= 1:
        return ros_map.crop((start + goal) / 2, size_m)
    cell = factor * ros_map.resolution
    return ros_map.crop((start + goal) / 2, math.ceil(size_m / cell - ROUNDING) * cell).coarser(
        factor
    )


def _check_on_map(ros_map: RosMap, name: str, place: NDArray[np.float64]) -> None:
    low, high = ros_map.extent
    if not ((low <= place) & (place <= high)).all():
        (x_low, y_low), (x_high, y_high) = low, high
        hint = place_hint(*place.tolist(), low=low, high=high, resolution=ros_map.resolution)
        raise WindowError(
            f"{name}: expected a place on the map (x from {x_low:g} to {x_high:g} m and y from "
            f"{y_low:g} to {y_high:g} m), got ({place[0]:g}, {place[1]:g}) m{hint}"
        )


def read_layer(path: Path | str, ros_map: RosMap, window: RosMap, *, neutral: float) -> Grey:
    """Read a picture of a further channel in a window of its map: [H, W] in [0, 1], white is 1.

    Wider cells get the mean of those that they cover.

    neutral: of cells beyond the map

    Raises `RosMapError` if the file is no picture, or not of the map's size.
    """
    path, size = Path(path), ros_map.values.shape
    try:
        with _opened(path) as image:
            grey = np.asarray(image.convert("L"), dtype=np.float64)[::-1] / 255
    except _UNREADABLE as error:
        raise RosMapError(f"{path}: expected a .pgm or .png picture: {error}") from error
    if grey.shape != size:
        raise RosMapError(
            f"{path}: expected {size[1]} x {size[0]} pixels, as the map has, "
            f"got {grey.shape[1]} x {grey.shape[0]}"
        )
    left, bottom = np.rint((window.origin - ros_map.origin) / ros_map.resolution).astype(int)
    (height, width), step = window.values.shape, round(window.resolution / ros_map.resolution)
    rows, columns = np.indices((step * height, step * width)) + np.array([[[bottom]], [[left]]])
    known = (rows >= 0) & (rows < size[0]) & (columns >= 0) & (columns < size[1])
    seen = np.where(known, grey[rows.clip(0, size[0] - 1), columns.clip(0, size[1] - 1)], neutral)
    return seen.reshape(height, step, width, step).mean(axis=(1, 3))


@dataclass(frozen=True)
class _Thresholds:
    free: float
    occupied: float


def _trinary(darkness: Grey, thresholds: _Thresholds) -> Grey:
    """Return 0 for free, 100 for occupied, -1 (unknown) between the thresholds."""
    between = np.where(darkness <= thresholds.free, 0.0, -1.0)
    return np.where(darkness >= thresholds.occupied, 100.0, between)


def _scale(darkness: Grey, thresholds: _Thresholds) -> Grey:
    """Return percent, linear between the thresholds."""
    span = thresholds.occupied - thresholds.free
    return np.rint(np.clip((darkness - thresholds.free) / span, 0.0, 1.0) * 100)


def _raw(shade: Grey, _: _Thresholds) -> Grey:
    """Return the pixel value as percent; above 100 it is -1 (unknown)."""
    percent = np.rint(255 * shade)
    return np.where(percent <= 100, percent, -1.0)


_PERCENT_OF_MODE: dict[str, Callable[[Grey, _Thresholds], Grey]] = {
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
        came = self.values.get(name, default)
        value = came.lower() if isinstance(came, str) else came
        if choices == (0, 1) and isinstance(value, str):
            value = _FLAGS.get(value, value)
        if value not in choices:
            raise self.error(name, f"one of {', '.join(map(str, choices))}", came)
        return value


_FLAGS = {"true": 1, "yes": 1, "on": 1, "false": 0, "no": 0, "off": 0}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE | re.ASCII)


def _scalar(value: Any) -> Any:
    """Return the number that a text of YAML is for yaml-cpp, which knows `5e-2`; else the text."""
    if isinstance(value, list):
        return [_scalar(each) for each in value]
    if not isinstance(value, str) or not _NUMBER.fullmatch(value):
        return value
    return int(value) if value.lstrip("+-").isdigit() else float(value)


def _is_number(value: object) -> TypeGuard[float]:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return -math.inf < value < math.inf  # math.isfinite fails for huge integers


def _origin(fields: _Fields) -> NDArray[np.float64]:
    origin = fields.values.get("origin")
    if not isinstance(origin, list) or len(origin) != 3 or not all(map(_is_number, origin)):
        raise fields.error("origin", "three numbers x, y, yaw", origin)
    if not abs(math.remainder(origin[2], math.tau)) <= MAX_YAW:
        raise fields.error("origin", "a yaw of 0 (turned maps are not supported)", origin[2])
    if not all(map(COORDINATE.holds, origin)):
        raise fields.error("origin", f"numbers {COORDINATE}", origin)
    return np.array(origin[:2], dtype=np.float64)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        # This loader makes texts of all scalars, and nothing else.
        values = yaml.BaseLoader(path.read_text(encoding="utf-8")).get_single_data()
    except (OSError, ValueError, yaml.YAMLError) as error:
        said = " ".join(str(error).split())
        raise RosMapError(f"{path}: expected a map_server YAML file: {said}") from error
    if not isinstance(values, dict):
        raise RosMapError(f"{path}: expected a map_server YAML file with named fields")
    return {name: _scalar(value) for name, value in values.items()}


class _Pgm(NamedTuple):
    """Where the pixels of a .pgm in bytes are."""

    shape: tuple[int, int]
    brightest: int
    offset: int

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(np.uint8 if self.brightest < 256 else ">u2")


_PGM_HEAD = re.compile(rb"P5" + 3 * rb"(?:\s+(?:#[^\n\r]*[\n\r]\s*)*)(\d{1,9})" + rb"\s")


class _PictureCells:
    """The cells [H, W] of a picture, row 0 at its bottom, in percent or -1; a slice reads them."""

    dtype = np.dtype(np.int8)

    def __init__(self, path: Path, percent: Callable[[Grey], Grey]) -> None:
        self._path, self._percent = path, percent
        self._image: Image.Image | None = None
        try:
            self._pgm = _pgm_of(path)
            if self._pgm is not None:
                self.shape = self._pgm.shape
            else:
                with _opened(path) as image:
                    self.shape = (image.height, image.width)
        except _UNREADABLE as error:
            raise self._damaged(error) from error

    def __getitem__(self, window: tuple[slice, slice]) -> NDArray[np.int8]:
        """Return the cells of a window: its rows and its columns, each one after the other."""
        (bottom, top, _), (left, right, _) = (
            part.indices(size) for part, size in zip(window, self.shape, strict=True)
        )
        height = self.shape[0]
        try:
            shade, opaque = self._shade(height - top, height - bottom, left, right)
        except _UNREADABLE as error:
            raise self._damaged(error) from error
        return np.where(opaque, self._percent(shade), -1)[::-1].astype(np.int8)

    def _shade(
        self, top: int, bottom: int, left: int, right: int
    ) -> tuple[Grey, NDArray[np.bool_] | bool]:
        """Return the mean colour [h, w] in [0, 1], top row first, and whether pixels are opaque."""
        if (pgm := self._pgm) is not None:
            pixels = np.memmap(self._path, pgm.dtype, "r", pgm.offset, pgm.shape)
            return pixels[top:bottom, left:right] / float(pgm.brightest), True
        part = self._decoded().crop((left, top, right, bottom))
        if part.mode.startswith("I"):  # 16 bits a pixel
            return np.asarray(part, dtype=np.float64) / 65535, True
        channels = np.asarray(part.convert("RGBA"), dtype=np.float64) / 255
        return channels[..., :3].mean(axis=-1), channels[..., 3] == 1

    def _decoded(self) -> Image.Image:
        """Return the picture, which is kept for the next window unless it is large."""
        if (kept := self._image) is not None:
            return kept
        with _opened(self._path) as image:
            image.load()
        if image.width * image.height <= KEPT_PIXELS:
            self._image = image
        return image

    def _damaged(self, error: Exception) -> RosMapError:
        return RosMapError(f"{self._path}: image: expected a .pgm or .png picture: {error}")


# Pillow raises the first three for a damaged file.
_UNREADABLE = (OSError, ValueError, SyntaxError, Image.DecompressionBombError)


def _pgm_of(path: Path) -> _Pgm | None:
    """Return where the pixels are, or None if the file is no .pgm in bytes."""
    with path.open("rb") as file:
        head = file.read(4096)
    if not head.startswith(b"P5"):
        return None
    if (found := _PGM_HEAD.match(head)) is None:
        raise ValueError("its head has no width, height and greatest value")
    width, height, brightest = map(int, found.groups())
    if not (width and height and 0 < brightest < 65536):
        raise ValueError(f"{width} x {height} pixels of at most {brightest}")
    pgm = _Pgm((height, width), brightest, found.end())
    if path.stat().st_size < pgm.offset + width * height * pgm.dtype.itemsize:
        raise ValueError(f"it ends before its {width} x {height} pixels do")
    return pgm


def _opened(path: Path) -> Image.Image:
    """Open a picture; a large .png too, which `Image.open` takes for an attack."""
    with path.open("rb") as file:
        is_png = file.read(8) == b"\x89PNG\r\n\x1a\n"
    image = PngImagePlugin.PngImageFile(path) if is_png else Image.open(path)
    if image.width * image.height > MAX_PIXELS:
        image.close()
        raise ValueError(f"expected at most {MAX_PIXELS} pixels, or a .pgm, which may have more")
    return image
