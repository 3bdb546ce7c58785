"""A provider that is requested and not obtained is an error, not a quiet run on the CPU."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import onnxruntime as ort
import pytest

from anchorflow_service.bundle import load_bundle
from anchorflow_service.bundle.providers import (
    ProviderError,
    check_obtained,
    preferences,
    provider_named,
)
from anchorflow_service.engine import Engine

WITHOUT_CUDA = pytest.mark.skipif(
    "CUDAExecutionProvider" in ort.get_available_providers(), reason="this onnxruntime has CUDA"
)


def test_the_cpu_is_everywhere() -> None:
    assert provider_named("cpu") == "CPUExecutionProvider"


def test_an_unknown_provider_is_named() -> None:
    with pytest.raises(ProviderError, match=r"expected one of cpu, cuda.*got 'gpu'"):
        provider_named("gpu")


@WITHOUT_CUDA
def test_an_engine_does_not_start_on_a_provider_that_is_missing(tiny_bundle: Path) -> None:
    with pytest.raises(ProviderError, match=r"cuda is not in this build.*offers cpu"):
        Engine(load_bundle(tiny_bundle), provider="cuda")


def test_a_fallback_is_noticed() -> None:
    """As onnxruntime does where CUDA's libraries are missing: the session opens on the CPU."""
    session = SimpleNamespace(get_providers=lambda: ["CPUExecutionProvider"])
    with pytest.raises(ProviderError, match=r"asked for CUDA.*took CPU.*field.onnx"):
        check_obtained(session, "CUDAExecutionProvider", Path("field.onnx"))  # pyright: ignore[reportArgumentType]


CUDA, TENSORRT = "CUDAExecutionProvider", "TensorrtExecutionProvider"


@pytest.mark.parametrize(
    ("wanted", "offered", "asked_for"),
    [
        (TENSORRT, [TENSORRT, CUDA, "CPUExecutionProvider"], [TENSORRT, CUDA]),
        (TENSORRT, [TENSORRT, "CPUExecutionProvider"], [TENSORRT]),
        (CUDA, [TENSORRT, CUDA, "CPUExecutionProvider"], [CUDA]),
    ],
)
def test_what_tensorrt_does_not_take_goes_to_cuda(
    wanted: str, offered: list[str], asked_for: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ort, "get_available_providers", lambda: offered)
    assert [name for name, _ in preferences(wanted)] == asked_for


def test_cuda_multiplies_in_float32() -> None:
    assert dict(preferences(CUDA))[CUDA] == {"use_tf32": "0"}
