"""Execution providers: where onnxruntime runs the graphs, and the memory that they compute in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from anchorflow_client.errors import AnchorFlowError

PROVIDERS = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
}
DEFAULT_PROVIDER = "cpu"
# Providers for the nodes that the wanted one does not support. The CPU would take them, and every
# tensor between them would cross from the device and back.
HELPERS = {PROVIDERS["tensorrt"]: (PROVIDERS["cuda"],)}
# Multiply float32 as the CPU does, not with mantissas of ten bits, which is CUDA's default.
OPTIONS = {PROVIDERS["cuda"]: {"use_tf32": "0"}}
FIRST_DEVICE = 0  # onnxruntime's providers take the first device by default

Preference: TypeAlias = tuple[str, dict[str, str]]
"""A provider by onnxruntime's name, and its options."""


class ProviderError(AnchorFlowError):
    """The requested execution provider is not available."""


def provider_named(name: str) -> str:
    """Return onnxruntime's own name of a provider. Raises `ProviderError` if it lacks that."""
    if name not in PROVIDERS:
        raise ProviderError(f"provider: expected one of {', '.join(PROVIDERS)}, got {name!r}")
    offered = ort.get_available_providers()
    if PROVIDERS[name] not in offered:
        known = ", ".join(short for short, full in PROVIDERS.items() if full in offered)
        raise ProviderError(
            f"provider: {name} is not in this build of onnxruntime, which offers {known}"
        )
    return PROVIDERS[name]


def preferences(wanted: str) -> list[Preference]:
    """Return the providers of a session: the wanted one, then its helpers."""
    offered = ort.get_available_providers()
    names = [wanted, *(name for name in HELPERS.get(wanted, ()) if name in offered)]
    return [(name, OPTIONS.get(name, {})) for name in names]


def check_obtained(session: ort.InferenceSession, wanted: str, path: Path) -> None:
    """Raise `ProviderError` if onnxruntime fell back to another provider, which it does silently.

    A build that has a provider still loses it if the driver or a library is missing.
    """
    obtained = session.get_providers()[0]
    if obtained != wanted:
        raise ProviderError(
            f"provider: asked for {wanted}, onnxruntime took {obtained} for {path.name}: "
            "are its driver and libraries installed?"
        )


@dataclass(frozen=True)
class Device:
    """The memory of a device that is not the host's.

    name: onnxruntime's name of the device
    provider: runs single operations there; TensorRT would build an engine for each
    """

    name: str
    provider: str

    def upload(self, array: NDArray[Any]) -> ort.OrtValue:
        return ort.OrtValue.ortvalue_from_numpy(
            np.ascontiguousarray(array), self.name, FIRST_DEVICE
        )

    def empty(self, shape: Sequence[int]) -> ort.OrtValue:
        """Allocate float32 of a shape on the device, to be written into."""
        return ort.OrtValue.ortvalue_from_shape_and_type(shape, np.float32, self.name, FIRST_DEVICE)


CUDA = Device("cuda", provider="cuda")
DEVICES = {"cuda": CUDA, "tensorrt": CUDA}
"""Devices by provider. The CPU's memory is the host's own, and OpenVINO reads from it."""
