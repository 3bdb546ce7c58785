"""Pictures are resized as image libraries do it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from PIL import Image

from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import resized


@pytest.mark.parametrize(("height", "width", "size"), [(120, 190, 64), (20, 33, 64), (64, 90, 64)])
def test_it_is_pillows_bicubic(height: int, width: int, size: int) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    wanted = np.asarray(
        Image.fromarray(pixels).resize((size, size), Image.Resampling.BICUBIC), dtype=int
    )

    got = resized(pixels.transpose(2, 0, 1), size).transpose(1, 2, 0)

    assert np.abs(got - wanted).max() <= 1  # Pillow rounds its weights
    assert (got != wanted).mean() < 0.01


def test_axes_before_are_kept_and_the_size_itself_is_free() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (2, 3, 40, 30), dtype=np.uint8)
    both = resized(pixels, 24)
    assert (both.shape, both.dtype) == ((2, 3, 24, 24), np.uint8)
    np.testing.assert_array_equal(both[1], resized(pixels[1], 24))
    assert resized(both, 24) is both


PIXELS = np.zeros((3, 20, 30), np.uint8)
WRONG: dict[str, tuple[Any, Any, str]] = {
    "floats": (
        PIXELS / 255,
        16,
        "pixels: expected an array of uint8 [...,3,H,W], none of its sides 0, got an array of "
        "float64 and shape [3, 20, 30]",
    ),
    "floats of that size": (PIXELS[:, :16, :16] / 255, 16, "pixels: expected an array of uint8"),
    "colours last": (
        PIXELS.transpose(1, 2, 0),
        16,
        "shape [20, 30, 3]; np.moveaxis(pixels, -1, -3) puts the colours first",
    ),
    "colours last, of two": (np.zeros((2, 20, 30, 3), np.uint8), 16, "np.moveaxis(pixels, -1, -3)"),
    "grey": (PIXELS[0], 16, "pixels: expected an array of uint8 [...,3,H,W]"),
    "no rows": (PIXELS[:, :0], 16, "pixels: expected an array of uint8 [...,3,H,W]"),
    "no pictures": (PIXELS[None, ..., :0, :0], 16, "none of its sides 0, got an array of uint8"),
    "lists": (PIXELS.tolist(), 16, "pixels: expected an array of uint8 [...,3,H,W]"),
    "nothing": (PIXELS, 0, "size: expected an integer from 1 to 4096, got 0"),
    "less": (PIXELS, -1, "size: expected an integer from 1 to 4096, got -1"),
    "half a pixel": (PIXELS, 16.0, "size: expected an integer from 1 to 4096, got 16.0"),
    "more than a picture has": (PIXELS, 2**31, "size: expected an integer from 1 to 4096"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_picture_or_no_size_is_refused_by_name(case: str) -> None:
    pixels, size, message = WRONG[case]
    with pytest.raises(InvalidRequest, match=re.escape(message)):
        resized(pixels, size)
