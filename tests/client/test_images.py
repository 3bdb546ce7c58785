"""Pictures are resized as image libraries do it."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from anchorflow_client.images import resized


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
