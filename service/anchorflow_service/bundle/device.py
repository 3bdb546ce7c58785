"""The memory that a provider computes in, where that is not the host's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

FIRST = 0  # onnxruntime's providers take the first device unless told otherwise


@dataclass(frozen=True)
class Device:
    """One device's memory.

    name: as onnxruntime calls it
    provider: of single operations there; TensorRT would build an engine for each
    """

    name: str
    provider: str

    def upload(self, array: NDArray[Any]) -> ort.OrtValue:
        """The array there."""
        return ort.OrtValue.ortvalue_from_numpy(np.ascontiguousarray(array), self.name, FIRST)

    def empty(self, shape: Sequence[int]) -> ort.OrtValue:
        """float32 of a shape there, to be written into."""
        return ort.OrtValue.ortvalue_from_shape_and_type(shape, np.float32, self.name, FIRST)


CUDA = Device("cuda", provider="cuda")
DEVICES = {"cuda": CUDA, "tensorrt": CUDA}
"""By provider. The CPU's is the host's own memory, and OpenVINO is fed from it."""
