"""The ground as a picture from above: road, verge, crosswalks and painted lines."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.errors import SensorError
from anchorflow_driving.geometry import Array, arc_lengths, points_in_polygon
from anchorflow_driving.window import PlannerView

CELL = 0.125
"""m a pixel."""
WIDEST = 16384
"""Pixels a side: what OpenGL takes as one texture."""
MARGIN = 20.0
"""m of verge around the road."""
ASPHALT, VERGE, PAINT, STRIPE = (88, 88, 92), (98, 112, 74), (214, 214, 208), (196, 196, 192)
GRAIN, GRAIN_TILE = 5.0, 512  # of 255, pixels
LINE_WIDTH = 0.15  # m
DASH, GAP = 3.0, 4.5  # m
STRIPE_PERIOD = 1.0  # m, of a crosswalk's stripes and gaps


@dataclass(frozen=True, eq=False)
class GroundPicture:
    """A picture in the log's frame; row 0 is at the lowest y, column 0 at the lowest x."""

    pixels: NDArray[np.uint8]  # [H, W, 3]
    low: Array  # [2] m, its corner

    @property
    def size(self) -> Array:
        """[2] m in x and y."""
        return np.array(self.pixels.shape[1::-1]) * CELL


def paint_ground(view: PlannerView) -> GroundPicture:
    """The ground of a view's whole map, in the log's frame.

    Raises `SensorError` if the map is wider than WIDEST.
    """
    rings = view.log_polylines["drivable"]
    corners = np.concatenate(rings) if rings else np.zeros((1, 2))
    low = corners.min(0) - MARGIN
    columns, rows = np.ceil((corners.max(0) + MARGIN - low) / CELL).astype(int)
    if max(rows, columns) > WIDEST:
        raise SensorError(
            f"drivable_points: expected a map of at most {WIDEST * CELL - 2 * MARGIN:g} m to be"
            f" drawn, got {np.ptp(corners, axis=0).max():.0f} m: crop it"
        )
    x = low[0] + (np.arange(columns) + 0.5) * CELL
    y = low[1] + (np.arange(rows) + 0.5) * CELL
    drivable = np.stack([view.road.is_drivable(np.stack([x, x * 0 + each], -1)) for each in y])
    colours = np.array([VERGE, ASPHALT], np.float32)
    pixels = colours[drivable.astype(int)]
    grain = np.random.default_rng(0).normal(0.0, GRAIN, (GRAIN_TILE, GRAIN_TILE))
    tiles = -(-rows // GRAIN_TILE), -(-columns // GRAIN_TILE)
    pixels += np.tile(grain.astype(np.float32), tiles)[:rows, :columns, None]
    for polygon in view.log_polylines["crosswalk"]:
        _paint_stripes(pixels, polygon, low)
    for line, solid in zip(view.log_polylines["line"], view.line_solid, strict=True):
        _paint_line(pixels, line, low, solid=bool(solid))
    return GroundPicture(pixels.clip(0, 255).astype(np.uint8), low)


def _paint_stripes(pixels: NDArray[np.float32], polygon: Array, low: Array) -> None:
    """Stripes along a crosswalk's shorter axis, a metre from one to the next."""
    cells = (polygon - low) / CELL
    (c0, r0), (c1, r1) = np.floor(cells.min(0)).astype(int), np.ceil(cells.max(0)).astype(int)
    rows, columns = np.mgrid[r0:r1, c0:c1]
    places = np.stack([columns.ravel(), rows.ravel()], -1) + 0.5
    inside = points_in_polygon(places, cells)
    # People walk along its longer axis.
    _, axes = np.linalg.eigh(np.cov(cells.T))
    along = places @ axes[:, -1] * CELL
    striped = inside & (along % STRIPE_PERIOD < STRIPE_PERIOD / 2)
    _colour(pixels, rows.ravel()[striped], columns.ravel()[striped], STRIPE)


def _paint_line(pixels: NDArray[np.float32], line: Array, low: Array, *, solid: bool) -> None:
    length = arc_lengths(line)
    for (begin, end), (start, stop) in zip(pairwise(length), pairwise(line), strict=True):
        step = max(int(np.ceil((end - begin) / (CELL / 2))), 1)
        share = (np.arange(step) + 0.5) / step
        shown = solid | ((begin + share * (end - begin)) % (DASH + GAP) < DASH)
        points = start + share[shown, None] * (stop - start)
        towards = (stop - start) / max(end - begin, 1e-9)
        for aside in np.arange(-LINE_WIDTH / 2, LINE_WIDTH / 2 + 1e-6, CELL / 2):
            moved = points + aside * np.array([-towards[1], towards[0]])
            column, row = np.floor((moved - low) / CELL).astype(int).T
            _colour(pixels, row, column, PAINT)


def _colour(
    pixels: NDArray[np.float32],
    rows: NDArray[np.integer],
    columns: NDArray[np.integer],
    colour: tuple[int, int, int],
) -> None:
    """Colour the pixels that there are: recorded lines may lead far beyond the road."""
    height, width = pixels.shape[:2]
    there = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    pixels[rows[there], columns[there]] = colour
