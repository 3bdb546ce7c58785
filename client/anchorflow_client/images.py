"""Pictures at the size that a planner sees: one rule for training, service and client.

A caller may send a picture of any size; one that is resized here first is a smaller request with
the same answer.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.checks import describe, integer
from anchorflow_client.contract.ranges import MAX_PIXELS, Interval
from anchorflow_client.errors import InvalidRequest

Pixels = NDArray[np.uint8]

COLOURS = 3
SIZE = Interval(1, math.isqrt(MAX_PIXELS))

SHARPNESS = -0.5
"""a of the cubic kernel (Keys 1981), as image libraries have it."""


def resized(pixels: Pixels, size: int) -> Pixels:
    """A picture [...,3,H,W] as [...,3,size,size].

    By cubic interpolation, averaged where it shrinks. The whole picture is kept and its sides are
    not in proportion any more, as the vision towers are trained with. A picture of that size comes
    back as it is.

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
    """values [n,...], their first axis resampled: [size,...], whole numbers from 0 to 255."""
    rows = np.ascontiguousarray(values, dtype=np.float32).reshape(len(values), -1)
    out = np.empty((size, rows.shape[1]), np.float32)
    index, weights = _taps(len(rows), size)
    # A product a row: the weights lie in a narrow band.
    for new, (first, share) in enumerate(zip(index[:, 0], weights, strict=True)):
        taps = rows[first : first + len(share)]
        np.dot(share[: len(taps)], taps, out=out[new])
    return np.clip(np.rint(out, out=out), 0, 255, out=out).reshape(size, *values.shape[1:])


def _taps(before: int, after: int) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Which rows make up a new one, and how much of it, 0 beyond the last: [after, taps] each."""
    stride = before / after
    stretch = max(stride, 1.0)  # where it shrinks, the kernel covers what falls together
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
