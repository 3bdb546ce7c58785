"""Convert a vehicle's sensor data to the inputs of driving planners, and resize pictures.

Simulated sensors of the training data use the same functions. Frame: the rear axle, x forward, y
left, metres.

Example:
    camera = stitch_cameras(left, front, right)
    lidar = lidar_histogram(points)
    lidar_before = lidar_histogram(points_before, pose=(-4.0, 0.0, 0.0))  # where the car was
    status = ego_status(command="left", velocity=(8.0, 0.0), acceleration=(0.3, 0.1))
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.batch import polyline
from anchorflow_client.contract.checks import Interval, as_array, choice, describe, integer, within
from anchorflow_client.contract.fields import COORDINATE, MAX_PIXELS
from anchorflow_client.errors import InvalidRequest

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]

COMMANDS = ("left", "straight", "right", "unknown")

CAMERA_ROWS, CAMERA_COLUMNS = 256, 1024
SIDE = Interval(1, MAX_PIXELS)
"""Allowed rows or columns of a picture."""
CROPPED_ROWS = 28 / 1080
"""Share of an image's height that is cut at its top and at its bottom."""
CROPPED_COLUMNS = 416 / 1920
"""Share of a side image's width that is cut at either side."""

LIDAR_RANGE_M = 32.0
LIDAR_CELLS_PER_M = 4
LIDAR_LEAST_HEIGHT_M = 0.2
LIDAR_MOST_POINTS = 5
FEW_POINTS, MOST_OF_A_POINT = 8, 32
"""A cloud of at most 8 points with over 32 numbers each is taken as transposed."""
LIDAR_BEFORE_S = 0.5
"""s between the two sweeps of a planner's inputs, as in NAVSIM."""

ROUTE_POINTS, ROUTE_SPACING_M = 40, 2.0
"""Points of a planner's route, and their distance."""
OTHERS = 48
"""The most other road users of a request."""
OTHERS_TIMES_S = (-2.0, -1.5, -1.0, -0.5, 0.0)
"""Times of their states in s from now."""
X, Y, HEADING, VX, VY, LENGTH, WIDTH, KIND = range(8)
"""The numbers of a state."""
KINDS = (1, 2, 3)
"""Vehicle, person, cyclist; 0 in unused rows."""
SAME_POINT = 1e-6  # m; nearer points of a polyline are one
SAME_ARM_M = 3.0
"""m more than to the nearest arm of a route, up to which the car may be on another one."""


def stitch_cameras(
    left: ArrayLike,
    front: ArrayLike,
    right: ArrayLike,
    *,
    rows: int = CAMERA_ROWS,
    columns: int = CAMERA_COLUMNS,
) -> Bytes:
    """Stitch three cameras side by side, as NAVSIM does: uint8 [3, rows, columns].

    Of images of 1920 x 1080 pixels, 28 rows are cut at the top and at the bottom, and 416 columns
    at either side of the left and the right one; from other sizes the same shares. The rest is
    resized by averaging areas.

    Args:
        left, front, right: uint8 [H, W, 3], of one size, red first.

    Raises:
        InvalidRequest: names `camera_left`, `camera_front`, `camera_right`, `rows` or `columns`.
    """
    images = {"left": left, "front": front, "right": right}
    arrays = {name: _image(image, f"camera_{name}") for name, image in images.items()}
    height, width = arrays["front"].shape[:2]
    for name, image in arrays.items():
        if image.shape != (height, width, 3):
            told = f"expected the front's shape [{height}, {width}, 3], got {list(image.shape)}"
            raise InvalidRequest(told, f"camera_{name}")
    above, beside = round(CROPPED_ROWS * height), round(CROPPED_COLUMNS * width)
    cut = slice(above, height - above)
    sides = slice(beside, width - beside)
    stitched = np.concatenate(
        [arrays["left"][cut, sides], arrays["front"][cut], arrays["right"][cut, sides]], axis=1
    )
    resized = resize_image(stitched, rows=rows, columns=columns)
    return np.ascontiguousarray(resized.transpose(2, 0, 1))


def resize_image(image: ArrayLike, *, rows: int, columns: int) -> Bytes:
    """Resize an image [H, W, 3] to uint8 [rows, columns, 3]: each pixel is the mean of its area.

    Raises:
        InvalidRequest: names `image`, `rows` or `columns`.
    """
    pixels = _image(image, "image")
    rows, columns = integer(rows, "rows", SIDE), integer(columns, "columns", SIDE)
    if pixels.shape[:2] == (rows, columns):
        return pixels
    across = _area_weights(pixels.shape[1], columns)
    down = _area_weights(pixels.shape[0], rows)
    mean = np.einsum("rh,hwc,kw->rkc", down, pixels.astype(np.float32), across, optimize=True)
    return np.rint(mean).clip(0, 255).astype(np.uint8)


def lidar_histogram(points: ArrayLike, *, pose: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
    """Count points [P, 3 or more] (x, y, z above ground, m) in a raster [1, 256, 256] in [0, 1].

    Rows go by x and columns by y, both from -32 to 32 m, four cells a metre, as in NAVSIM.
    Points higher than 0.2 m are counted; five or more make 1.

    Args:
        pose: x, y (m) and heading (rad) of the frame of these points in the frame of now: where
            the rear axle was when an earlier sweep was taken.

    Raises:
        InvalidRequest: names `lidar` or `pose`.
    """
    frame = as_array(pose, "pose", np.float64)
    if frame.shape != (3,) or not np.isfinite(frame).all():
        raise InvalidRequest(f"expected x, y, heading, all finite, got {frame.tolist()}", "pose")
    cloud = as_array(points, "lidar", np.float32)
    if cloud.ndim != 2 or cloud.shape[1] < 3:
        raise InvalidRequest(f"expected shape [P, 3], got {list(cloud.shape)}", "lidar")
    if len(cloud) <= FEW_POINTS and cloud.shape[1] > MOST_OF_A_POINT:
        came = f"{list(cloud.shape)}; .T turns a cloud of columns"
        raise InvalidRequest(f"expected shape [P, 3], got {came}", "lidar")
    if not np.isfinite(cloud[:, :3]).all():
        raise InvalidRequest("expected finite numbers, got NaN or infinity", "lidar")
    cells = round(2 * LIDAR_RANGE_M * LIDAR_CELLS_PER_M)
    high = cloud[cloud[:, 2] > LIDAR_LEAST_HEIGHT_M, :2]
    if frame.any():
        cos, sin = np.cos(frame[2]), np.sin(frame[2])
        high = high @ np.array([[cos, sin], [-sin, cos]]) + frame[:2]
    # Coordinates beyond the range may overflow an integer.
    near = high[(np.abs(high) <= LIDAR_RANGE_M).all(1)]
    cell = np.floor((near + LIDAR_RANGE_M) * LIDAR_CELLS_PER_M).astype(int)
    cell = cell[(cell < cells).all(1)]
    counts = np.bincount(cell @ (cells, 1), minlength=cells**2).reshape(1, cells, cells)
    return (np.minimum(counts, LIDAR_MOST_POINTS) / LIDAR_MOST_POINTS).astype(np.float32)


def ego_status(*, command: str, velocity: ArrayLike, acceleration: ArrayLike) -> Floats:
    """Return [8]: the command one-hot, velocity x, y (m/s), acceleration x, y (m/s²).

    Args:
        command: left, straight, right or unknown.
        velocity, acceleration: of the rear axle, in its frame.

    Raises:
        InvalidRequest: names `command`, `velocity` or `acceleration`.
    """
    choice(command, "command", COMMANDS)
    vectors = {"velocity": velocity, "acceleration": acceleration}
    numbers = {name: as_array(value, name, np.float32) for name, value in vectors.items()}
    for name, value in numbers.items():
        if value.shape != (2,):
            raise InvalidRequest(f"expected shape [2], got {list(value.shape)}", name)
        if not np.isfinite(value).all():
            raise InvalidRequest(f"expected finite numbers, got {value.tolist()}", name)
    one_hot = np.array([name == command for name in COMMANDS], np.float32)
    return np.concatenate([one_hot, *numbers.values()])


def route_ahead(points: ArrayLike) -> Floats:
    """Resample a route for planners: [40, 2] m, 2 m apart, the first beside the car.

    It continues straight after the end of the polyline.

    Args:
        points: [V, 2] m, a polyline in the frame of the rear axle, two points or more, none of
            them farther away than 10,000 km.

    Raises:
        InvalidRequest: names `route`.
    """
    line = within(polyline(points), "route", COORDINATE)
    gaps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    line = line[np.concatenate([[True], gaps > SAME_POINT])]
    if len(line) < 2:
        raise InvalidRequest("expected two or more points apart from each other, got one", "route")
    along = np.diff(line, axis=0)
    length = np.linalg.norm(along, axis=1)
    share = np.clip(-(line[:-1] * along).sum(-1) / length**2, 0.0, 1.0)
    nearest = _arm(np.linalg.norm(line[:-1] + share[:, None] * along, axis=1), along)
    arc = np.concatenate([[0.0], length.cumsum()])
    at = arc[nearest] + share[nearest] * length[nearest] + ROUTE_SPACING_M * np.arange(ROUTE_POINTS)
    beyond = np.maximum(at - arc[-1], 0.0)[:, None] * along[-1] / length[-1]
    places = np.stack([np.interp(at, arc, axis) for axis in line.T], -1)
    return (places + beyond).astype(np.float32)


def _arm(apart: NDArray[np.floating], along: NDArray[np.floating]) -> int:
    """Return which edge [E] of a route a car is on: the nearest one; where the route comes back to
    the car, the nearest of the arm that leads its way.

    apart: [E] m from the car; along: [E, 2]
    """
    near = np.flatnonzero(apart <= apart.min() + SAME_ARM_M)
    arms = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
    nearest = [arm[apart[arm].argmin()] for arm in arms]
    return int(min(nearest, key=lambda edge: abs(np.arctan2(along[edge, 1], along[edge, 0]))))


def _image(image: ArrayLike, field: str) -> Bytes:
    pixels = as_array(image, field)
    if pixels.dtype != np.uint8:
        raise InvalidRequest(f"expected uint8, got {pixels.dtype}", field)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise InvalidRequest(f"expected shape [H, W, 3], got {list(pixels.shape)}", field)
    return pixels


def _area_weights(before: int, after: int) -> Floats:
    """Return [after, before]: the share of each old pixel in each new one."""
    edges = np.linspace(0.0, before, after + 1)
    start, end = edges[:-1, None], edges[1:, None]
    pixel = np.arange(before)
    covered = np.minimum(end, pixel + 1) - np.maximum(start, pixel)
    return (np.maximum(covered, 0.0) / (end - start)).astype(np.float32)


Pixels = NDArray[np.uint8]

COLOURS = 3
SIZE = Interval(1, math.isqrt(MAX_PIXELS))

SHARPNESS = -0.5
"""a of the cubic kernel (Keys 1981), as in image libraries."""


def resized(pixels: Pixels, size: int) -> Pixels:
    """Resize a picture [...,3,H,W] to [...,3,size,size].

    By cubic interpolation, averaged when shrinking. The whole picture is stretched to a square, as
    in the training of vision towers. A picture of that size is returned unchanged.

    Raises:
        InvalidRequest: names `pixels` or `size`.
    """
    _check_picture(pixels)
    size = integer(size, "size", SIZE)
    height, width = pixels.shape[-2:]
    if (height, width) == (size, size):
        return pixels
    flat = pixels.reshape(-1, height, width)
    columns = _along(flat.transpose(2, 1, 0), size)  # [size,H,C]
    both = _along(columns.transpose(1, 0, 2), size)  # [size,size,C]
    return both.transpose(2, 0, 1).astype(np.uint8).reshape(*pixels.shape[:-2], size, size)


def _check_picture(pixels: Any) -> None:
    is_bytes = isinstance(pixels, np.ndarray) and pixels.dtype == np.uint8
    shape = pixels.shape if is_bytes and pixels.size else ()
    if len(shape) >= 3 and shape[-3] == COLOURS:
        return
    told = f"expected an array of uint8 [...,3,H,W], none of its sides 0, got {describe(pixels)}"
    if len(shape) >= 3 and shape[-1] == COLOURS:
        told += "; np.moveaxis(pixels, -1, -3) puts the colours first"
    raise InvalidRequest(told, "pixels")


def _along(values: NDArray[Any], size: int) -> NDArray[np.float32]:
    """Resample the first axis of values [n,...]: [size,...], whole numbers from 0 to 255."""
    rows = np.ascontiguousarray(values, dtype=np.float32).reshape(len(values), -1)
    out = np.empty((size, rows.shape[1]), np.float32)
    index, weights = _taps(len(rows), size)
    # One product for each row, as the weights are a narrow band.
    for new, (first, share) in enumerate(zip(index[:, 0], weights, strict=True)):
        taps = rows[first : first + len(share)]
        np.dot(share[: len(taps)], taps, out=out[new])
    return np.clip(np.rint(out, out=out), 0, 255, out=out).reshape(size, *values.shape[1:])


def _taps(before: int, after: int) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return the rows of each new row and their weights, 0 beyond the last: [after, taps] each."""
    stride = before / after
    stretch = max(stride, 1.0)  # when shrinking, the kernel covers all merged rows
    middle = (np.arange(after) + 0.5) * stride
    first = np.maximum((middle - 2 * stretch + 0.5).astype(int), 0)
    end = np.minimum((middle + 2 * stretch + 0.5).astype(int), before)
    index = first[:, None] + np.arange((end - first).max())
    weights = _cubic((index + 0.5 - middle[:, None]) / stretch)
    weights[index >= end[:, None]] = 0.0
    weights /= weights.sum(1, keepdims=True)
    return index, weights.astype(np.float32)


def _cubic(x: NDArray[Any]) -> NDArray[Any]:
    x, a = np.abs(x), SHARPNESS
    near = ((a + 2) * x - (a + 3)) * x * x + 1
    far = ((x - 5) * x + 8) * x * a - 4 * a
    return np.where(x < 1, near, np.where(x < 2, far, 0.0))


def others_before(states: ArrayLike, size: ArrayLike, kind: ArrayLike) -> Floats:
    """Return the input `others` [48, 5, 8] of a planner that predicts them, the nearest first.

    A row has, for each of OTHERS_TIMES_S, x, y (m), heading (rad), velocity x, y (m/s), length,
    width (m) of the box, and its kind: 1 vehicle, 2 person, 3 cyclist, 0 not there. Tracks without
    a state now are left out; of more than 48 the nearest are kept.

    Args:
        states: [K, 5, 5] x, y, heading, velocity x, y of the boxes' middles at OTHERS_TIMES_S; NaN
            at times at which one was not there.
        size: [K, 2] length, width, above 0.
        kind: [K], 1 to 3.

    Raises:
        InvalidRequest: names `states`, `size` or `kind`.
    """
    moves, boxes, kinds = (
        as_array(value, name, np.float64)
        for name, value in (("states", states), ("size", size), ("kind", kind))
    )
    count, times = len(moves), len(OTHERS_TIMES_S)
    for name, array, shape in (
        ("states", moves, (count, times, 5)),
        ("size", boxes, (count, 2)),
        ("kind", kinds, (count,)),
    ):
        if array.shape != shape:
            raise InvalidRequest(f"expected {[*shape]}, got {list(array.shape)}", name)
    if not np.isin(kinds, KINDS).all():
        raise InvalidRequest("expected 1, 2 or 3", "kind")
    if not (np.isfinite(boxes) & (boxes > 0)).all():
        raise InvalidRequest("expected m above 0", "size")
    away = np.hypot(moves[:, -1, X], moves[:, -1, Y])
    away[~np.isfinite(moves[:, -1]).all(-1)] = np.inf
    order = np.argsort(away, kind="stable")[:OTHERS]
    order = order[np.isfinite(away[order])]
    told = np.concatenate([boxes, kinds[:, None]], 1)[order, None].repeat(times, 1)
    rows = np.concatenate([moves[order], told], -1)
    rows[~np.isfinite(rows).all(-1)] = 0.0
    others = np.zeros((OTHERS, times, 8), np.float32)
    others[: len(rows)] = rows
    return others
