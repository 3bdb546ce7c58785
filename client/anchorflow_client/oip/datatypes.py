"""The protocol's names of the types that anchors are made of; little-endian on the wire."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DTYPE_OF: dict[str, np.dtype] = {
    "FP32": np.dtype("<f4"),
    "FP64": np.dtype("<f8"),
    "BOOL": np.dtype("?"),
}
FLOATS = ("FP32", "FP64")

_NAME_OF = {np.dtype(np.float32): "FP32", np.dtype(np.float64): "FP64", np.dtype(np.bool_): "BOOL"}


def name_of(dtype: np.dtype) -> str:
    """The protocol's name of one of the three types."""
    return _NAME_OF[dtype.newbyteorder("=")]


def to_wire(tensor: NDArray) -> memoryview:
    """A tensor's bytes in C order; no copy where it lies so already."""
    ordered = np.ascontiguousarray(tensor, dtype=DTYPE_OF[name_of(tensor.dtype)])
    return ordered.reshape(-1).view(np.uint8).data
