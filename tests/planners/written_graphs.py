"""Graphs on disk, and what a manifest says of them: for bundles that tests write by hand."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import onnx

DTYPES = {1: "float32", 2: "uint8"}


def write_graphs(folder: Path, graphs: Mapping[str, onnx.ModelProto]) -> dict[str, Any]:
    """Write each graph as ROLE.onnx; the manifest's `graphs`."""
    entries = {}
    for role, model in graphs.items():
        data = model.SerializeToString()
        (folder / f"{role}.onnx").write_bytes(data)
        entries[role] = {
            "file": f"{role}.onnx",
            "sha256": hashlib.sha256(data).hexdigest(),
            "opset": 20,
            "inputs": [_spec(value) for value in model.graph.input],
            "outputs": [_spec(value) for value in model.graph.output],
        }
    return entries


def _spec(value: onnx.ValueInfoProto) -> dict[str, Any]:
    tensor = value.type.tensor_type
    shape = [axis.dim_param or axis.dim_value for axis in tensor.shape.dim]
    return {"name": value.name, "dtype": DTYPES[tensor.elem_type], "shape": shape}
