"""Execution providers: where onnxruntime runs the graphs."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import onnxruntime as ort

from anchorflow_client.errors import AnchorFlowError

PROVIDERS = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
}
DEFAULT_PROVIDER = "cpu"
# Who takes the nodes that a provider does not; the CPU would, and every tensor between them would
# cross from the device and back.
HELPERS = {PROVIDERS["tensorrt"]: (PROVIDERS["cuda"],)}
# float32 is multiplied as on the CPU, and not with factors of ten bits, CUDA's default.
OPTIONS = {PROVIDERS["cuda"]: {"use_tf32": "0"}}

Preference: TypeAlias = tuple[str, dict[str, str]]
"""A provider by onnxruntime's name, and its options."""


class ProviderError(AnchorFlowError):
    """The execution provider that was asked for is not to be had here."""


def provider_named(name: str) -> str:
    """onnxruntime's own name of a provider of this installation.

    Raises:
        ProviderError: no such provider, or one that this build of onnxruntime lacks.
    """
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
    """The providers of a session: the wanted one, then its helpers."""
    offered = ort.get_available_providers()
    names = [wanted, *(name for name in HELPERS.get(wanted, ()) if name in offered)]
    return [(name, OPTIONS.get(name, {})) for name in names]


def check_obtained(session: ort.InferenceSession, wanted: str, path: Path) -> None:
    """Raise `ProviderError` where onnxruntime fell back to another provider, as it may in silence.

    A build that has a provider still loses it where the driver or a library is missing.
    """
    obtained = session.get_providers()[0]
    if obtained != wanted:
        raise ProviderError(
            f"provider: asked for {wanted}, onnxruntime took {obtained} for {path.name}: "
            "are its driver and libraries installed?"
        )
