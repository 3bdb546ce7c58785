"""The graph that advances a flow's states on a device: x + weight · slope.

It belongs to no bundle: it is the same for all of them, and ships with the service, which has no
onnx to write it with. After a change here `write_add_scaled` writes it anew; a test holds the file
against what this module says.
"""

from __future__ import annotations

import onnx

from anchorflow_export.tracing import OPSET
from anchorflow_service.engine.samplers.device_loop import ADD_SCALED

# The product in a node of its own, and rounded: so the sum is numpy's to the last bit on a CPU.
TEXT = f"""
<ir_version: 10, opset_import: ["": {OPSET}]>
add_scaled (float[B,N,T,S] x, float[B,N,T,S] slope, float weight) => (float[B,N,T,S] advanced)
{{
    term = Mul (slope, weight)
    advanced = Add (x, term)
}}
"""


def add_scaled() -> onnx.ModelProto:
    """The graph, of tensors [B,N,T,S] and a number."""
    model = onnx.parser.parse_model(TEXT)
    onnx.checker.check_model(model, full_check=True)
    return model


def write_add_scaled() -> None:
    """Write the graph where the service reads it."""
    onnx.save(add_scaled(), ADD_SCALED)
