"""An eight-bit field: integer products inside, nearly the same anchors outside."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import onnx
import pytest

from anchorflow_export.bundle import export_bundle
from anchorflow_export.quantization import quantize_field
from anchorflow_service.bundle import BundleError, load_bundle


@pytest.fixture
def bundle(tmp_path: Path, small_flow: Any, description: Any, adapted: Any) -> Path:
    export_bundle(adapted(small_flow()), description, out=tmp_path / "bundle")
    return tmp_path / "bundle"


def operations(bundle: Path, role: str) -> set[str]:
    path = load_bundle(bundle).graph_path(role)
    return {node.op_type for node in onnx.load(path).graph.node}


def test_the_field_alone_is_rounded(bundle: Path, caplog: pytest.LogCaptureFixture) -> None:
    before = load_bundle(bundle).manifest
    with caplog.at_level(logging.WARNING):
        moved = quantize_field(bundle)
    manifest = load_bundle(bundle).manifest  # its hashes and signatures hold
    assert 0.0 < moved.error < 0.05
    assert "MatMulInteger" in operations(bundle, "field")
    assert "MatMulInteger" not in operations(bundle, "encode") | operations(bundle, "modulate")
    assert manifest.graphs["field"].precision == "int8"
    assert manifest.graphs["encode"] == before.graphs["encode"]
    assert [path.name for path in bundle.parent.iterdir()] == ["bundle"]
    assert caplog.records == []


def test_a_broken_bundle_stays_as_it_is(bundle: Path) -> None:
    field = bundle / "field.onnx"
    field.write_bytes(field.read_bytes()[:-1])
    before = {path.name: path.read_bytes() for path in bundle.iterdir()}
    with pytest.raises(BundleError, match=r"field\.onnx"):
        quantize_field(bundle)
    assert {path.name: path.read_bytes() for path in bundle.iterdir()} == before
