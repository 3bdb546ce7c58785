"""A scene's reflection in its x axis: y changes its sign, and a heading does too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SIGNS = np.array([1.0, -1.0, -1.0], np.float32)  # of x, y and heading


def reflection(dim: int, *, fields: int = 1) -> NDArray[np.float32]:
    """Signs [fields * D] that reflect as many fields of D numbers: 3 for p, v, a."""
    return np.tile(SIGNS[:dim], fields)
