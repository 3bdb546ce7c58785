"""The BEV raster: what is around the ego, seen from above, drawn from a planner's view.

A stack of bytes, each the share of a cell that is covered, in 255ths. Row 0 lies farthest ahead,
column 0 farthest left. The route is not in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from anchorflow_driving.geometry import Array, box_corners, out_of_frame
from anchorflow_driving.log import CYCLIST, PEDESTRIAN, STATIC, VEHICLE, Polylines
from anchorflow_driving.window import PlannerView

Bytes = NDArray[np.uint8]

FULL = 255
DRAWING = 2
"""Counted up where the same view gets another raster: what is kept of the old ones is stale."""
FINE = 4
"""Cells of the drawing to a cell of the raster, a side."""
PLACES = 2
"""Sample points a side of a cell for the drivable area."""
EDGE = 0.25
"""Cells of the drawing by which Pillow's polygons are too large in the mean, a side."""
SPACING = 0.4
"""m between the points that a lane's centre is drawn with."""
BEFORE_FRAMES = 10
"""Ago, of the channel that shows where vehicles were."""

LANES = ("lanes_ahead", "lanes_left", "lanes_oncoming", "lanes_right")
KINDS = {"vehicles": (VEHICLE,), "people": (PEDESTRIAN, CYCLIST), "static": (STATIC,)}


@dataclass(frozen=True)
class BevGrid:
    """Which part of the ego's frame is drawn, and when the others are foretold.

    extent: least and greatest x, least and greatest y, m
    cell: m a side
    ahead_s: times at which boxes are drawn where their present velocity takes them
    """

    extent: tuple[float, float, float, float] = (-16.0, 80.0, -32.0, 32.0)
    cell: float = 0.5
    ahead_s: tuple[float, ...] = tuple(0.5 * k for k in range(1, 10))

    @property
    def rows(self) -> int:
        return round((self.extent[1] - self.extent[0]) / self.cell)

    @property
    def columns(self) -> int:
        return round((self.extent[3] - self.extent[2]) / self.cell)

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the channels, in their order."""
        foretold = tuple(f"occupied_{s:.1f}s" for s in self.ahead_s)
        road = ("drivable", *LANES, "crosswalks", "lines")
        return (*road, *KINDS, "vehicles_before", *foretold)

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.channels), self.rows, self.columns


BEV = BevGrid()
"""The raster that planners are trained on: 80 m ahead, which 15 m/s need for 4 s and a second's
look ahead of the car's front; 16 m behind; 32 m to either side."""


def draw_bev(view: PlannerView, grid: BevGrid = BEV) -> Bytes:
    """The raster [C, H, W] of a window, in the frame of the rear axle; no route, no future.

    drivable        one may drive there
    lanes_*         centrelines, each 255 times the share of its direction that points ahead,
                    left, back or right: max(0, cos), max(0, sin), max(0, -cos), max(0, -sin)
    crosswalks      polygons
    lines           painted lines
    vehicles, people, static    boxes now, without the ego's
    vehicles_before             where the vehicles were 1 s ago
    occupied_T                  all boxes at constant velocity, T from now
    """
    painter = _Painter(grid)
    lanes = painter.directed(view.polylines("centre"))
    now, before = view.tracks[:, -1], view.tracks[:, -1 - BEFORE_FRAMES]
    others = np.arange(len(now)) != view.ego
    of_kind = {name: others & np.isin(view.track_type, kinds) for name, kinds in KINDS.items()}
    boxes = [painter.boxes(now, view.track_size, which) for which in of_kind.values()]
    moved = [painter.boxes(_later(now, s), view.track_size, others) for s in grid.ahead_s]
    return np.stack(
        [
            _drivable(view, grid),
            *lanes,
            painter.polygons(view.polylines("crosswalk")),
            painter.lines(view.polylines("line")),
            *boxes,
            painter.boxes(before, view.track_size, of_kind["vehicles"]),
            *moved,
        ]
    )


def draw_boxes(states: Array, size: Array, grid: BevGrid) -> Bytes:
    """The boxes of those states [K, 5] that are there, in the raster's frame: [H, W]."""
    return _Painter(grid).boxes(states, size, np.ones(len(states), np.bool_))


def _later(states: Array, time: float) -> Array:
    """States [K, 5] after a time at constant velocity."""
    return np.concatenate([states[:, :2] + time * states[:, 3:], states[:, 2:]], axis=1)


def _drivable(view: PlannerView, grid: BevGrid) -> Bytes:
    """Shares of each cell's PLACES x PLACES places that are drivable."""
    step = grid.cell / PLACES
    x = grid.extent[1] - step * (np.arange(grid.rows * PLACES) + 0.5)
    y = grid.extent[3] - step * (np.arange(grid.columns * PLACES) + 0.5)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).astype(np.float64)
    held = view.road.is_drivable(out_of_frame(places, view.state.pose)).astype(np.float32)
    cells = held.reshape(grid.rows, PLACES, grid.columns, PLACES).mean((1, 3))
    return np.rint(FULL * cells).astype(np.uint8)


class _Painter:
    """Draws on a finer raster, in units of its cells."""

    def __init__(self, grid: BevGrid) -> None:
        self._grid = grid
        self._low = np.array([grid.extent[0], grid.extent[2]])
        self._high = np.array([grid.extent[1], grid.extent[3]])

    def boxes(self, states: Array, size: Array, which: NDArray[np.bool_]) -> Bytes:
        """The boxes of those states [K, 5] that are there and in sight."""
        seen = which & np.isfinite(states[:, 0])
        reach = size.max(1, initial=0.0)[:, None]
        with np.errstate(invalid="ignore"):  # NaN, of who is absent, is not in sight
            inside = (states[:, :2] > self._low - reach) & (states[:, :2] < self._high + reach)
        seen &= inside.all(1)
        edge = 2 * EDGE * self._grid.cell / FINE
        return self.polygons(box_corners(states[seen, :3], size[seen] - edge))

    def polygons(self, polygons: Iterable[Array]) -> Bytes:
        image, draw = self._canvas()
        for pixels in self._pixels(polygons):
            draw.polygon(pixels, fill=FULL)
        return np.asarray(image.reduce(FINE))

    def lines(self, lines: Iterable[Array]) -> Bytes:
        image, draw = self._canvas()
        for pixels in self._pixels(lines):
            draw.line(pixels, fill=FULL)
        return np.asarray(image.reduce(FINE))

    def directed(self, lines: Polylines) -> Bytes:
        """[4, H, W] of polylines: the parts of their directions that point each way."""
        cells = np.zeros((4, self._grid.rows * self._grid.columns), np.uint8)
        points, heading = _dense(self._segments(lines))
        cell: NDArray[np.int64] = np.floor((self._high - points) / self._grid.cell).astype(np.int64)
        inside = ((cell >= 0) & (cell < (self._grid.rows, self._grid.columns))).all(1)
        place = cell[inside, 0] * self._grid.columns + cell[inside, 1]
        for channel, turn in zip(cells, np.pi / 2 * np.arange(4), strict=True):
            share = np.rint(FULL * np.maximum(0.0, np.cos(heading[inside] - turn)))
            np.maximum.at(channel, place, share.astype(np.uint8))
        return cells.reshape(4, self._grid.rows, self._grid.columns)

    def _segments(self, lines: Polylines) -> Array:
        """[E, 2, 2] of all lines, those in sight."""
        if not lines:
            return np.zeros((0, 2, 2))
        points = np.concatenate(lines)
        joined = np.ones(len(points), bool)
        joined[np.cumsum([len(line) for line in lines]) - 1] = False
        first = np.flatnonzero(joined)
        segments = np.stack([points[first], points[first + 1]], axis=1)
        high, low = segments.max(1), segments.min(1)
        return segments[((high > self._low) & (low < self._high)).all(1)]

    def _pixels(self, shapes: Iterable[Array]) -> Iterator[list[float]]:
        """Column and row by turns, on the finer raster, of those in sight.

        x grows up the picture, y to its left.
        """
        shapes = [*shapes]
        if not shapes:
            return
        points = np.concatenate(shapes)
        ends = np.cumsum([len(shape) for shape in shapes])
        begins = np.concatenate([[0], ends[:-1]])
        high, low = (f.reduceat(points, begins) for f in (np.maximum, np.minimum))
        seen = ((high > self._low) & (low < self._high)).all(1)
        flat = ((self._high - points) * (FINE / self._grid.cell))[:, ::-1].ravel().tolist()
        for begin, end in zip(begins[seen].tolist(), ends[seen].tolist(), strict=True):
            yield flat[2 * begin : 2 * end]

    def _canvas(self) -> tuple[Image.Image, ImageDraw.ImageDraw]:
        image = Image.new("L", (self._grid.columns * FINE, self._grid.rows * FINE))
        return image, ImageDraw.Draw(image)


def _dense(segments: Array) -> tuple[Array, Array]:
    """Points [P, 2] along segments [E, 2, 2], at most SPACING apart, and their headings [P]."""
    along = segments[:, 1] - segments[:, 0]
    length = np.hypot(*along.T)
    count = np.maximum(1, np.ceil(length / SPACING)).astype(int)
    edge = np.repeat(np.arange(len(segments)), count)
    place = np.arange(len(edge)) - np.repeat(count.cumsum() - count, count)
    points = segments[edge, 0] + along[edge] * ((place + 0.5) / count[edge])[:, None]
    return points, np.arctan2(along[edge, 1], along[edge, 0])
