"""Bundles that tests write by hand: graphs of ONNX text, and the manifest that lists them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

DTYPES = {1: "float32", 2: "uint8"}


def write_graphs(
    folder: Path, texts: Mapping[str, str], constants: Mapping[str, Mapping[str, np.ndarray]]
) -> dict[str, Any]:
    """Write each graph as ROLE.onnx, with its constants by name; return the manifest's `graphs`."""
    entries = {}
    for role, text in texts.items():
        model = onnx.parser.parse_model(text)
        for name, array in constants.get(role, {}).items():
            model.graph.initializer.append(numpy_helper.from_array(array, name))
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


def write_manifest(folder: Path, name: str, **entries: Any) -> Path:
    """Write a manifest, by default of poses 0.5 s apart from tensors; return the folder."""
    usual = {
        "format": 2,
        "name": name,
        "version": "1.0.0",
        "planner": "by-hand",
        "conditioning": {"kind": "tensors"},
        "finish": {"kind": "none"},
        "time": {"steps": 8, "first_s": 0.5, "dt": 0.5},
    }
    (folder / "manifest.json").write_text(json.dumps(usual | entries, indent=2))
    return folder


def tensor(name: str, dtype: str, *shape: str | int, **told: Any) -> dict[str, Any]:
    """Return the entry of an input or an extra."""
    return {"name": name, "dtype": dtype, "shape": [*shape], **told}


def set_in_manifest(folder: Path, path: str, *, to: Any) -> None:
    """Set the value at a path, such as request.inputs.1.shape, in a manifest; ... deletes it."""
    file = folder / "manifest.json"
    manifest = json.loads(file.read_text())
    place, keys = manifest, [int(key) if key.isdigit() else key for key in path.split(".")]
    for key in keys[:-1]:
        place = place[key]
    if to is ...:
        del place[keys[-1]]
    else:
        place[keys[-1]] = to
    file.write_text(json.dumps(manifest))


def _spec(value: onnx.ValueInfoProto) -> dict[str, Any]:
    kind = value.type.tensor_type
    shape = [axis.dim_param or axis.dim_value for axis in kind.shape.dim]
    return tensor(value.name, DTYPES[kind.elem_type], *shape)
