"""The graph that advances a flow's states on a device: x + weight · slope.

It is the same for all bundles and ships with the service, which has no onnx to write it with. After
a change here, run `write_add_scaled`; a test compares the file with this module.
"""

from __future__ import annotations

import onnx

from anchorflow_export.tracing import OPSET
from anchorflow_service.engine.samplers.device_loop import ADD_SCALED

# The product is a node of its own, and rounded: so the sum is numpy's to the last bit on a CPU.
TEXT = f"""
<ir_version: 10, opset_import: ["": {OPSET}]>
add_scaled (float[B,N,T,S] x, float[B,N,T,S] slope, float weight) => (float[B,N,T,S] advanced)
{{
    term = Mul (slope, weight)
    advanced = Add (x, term)
}}
"""


def add_scaled() -> onnx.ModelProto:
    """Return the graph, which takes tensors [B,N,T,S] and a number."""
    model = onnx.parser.parse_model(TEXT)
    onnx.checker.check_model(model, full_check=True)
    return model


def write_add_scaled() -> None:
    """Write the graph to the file that the service reads."""
    onnx.save(add_scaled(), ADD_SCALED)
