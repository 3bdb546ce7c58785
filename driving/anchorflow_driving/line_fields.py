"""Polylines and polygons as a log's fields hold them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def line_fields(
    name: str, lines: Sequence[NDArray[np.float64]], *, mirror: float = 1.0
) -> dict[str, Any]:
    """`NAME_points` and `NAME_offsets` of polylines [V, 2]; y is multiplied by `mirror`."""
    offsets = np.cumsum([0, *(len(line) for line in lines)]).astype(np.int32)
    points = np.concatenate([*lines, np.zeros((0, 2))]) * [1.0, mirror]
    return {f"{name}_points": points.astype(np.float32), f"{name}_offsets": offsets}
