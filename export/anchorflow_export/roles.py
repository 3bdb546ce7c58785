"""The three graphs of a flow model, traced with examples of sizes that mean nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import onnx
import torch
from torch import Tensor, nn

from anchorflow_client.contract import TensorSpec
from anchorflow_export.errors import ExportError
from anchorflow_export.graphs import (
    F32,
    TIMES,
    Encode,
    Field,
    FlowModel,
    Modulate,
    context_names,
    encode_inputs,
    encode_outputs,
)
from anchorflow_export.tracing import AXES, output_specs, trace

EXAMPLE_SIZES = {"B": 2, "N": 3, "K": 5, "H": 24, "W": 20}


@dataclass(frozen=True, eq=False)
class TracedGraph:
    """An ONNX graph and its signature."""

    model: onnx.ModelProto
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]


def trace_roles(model: FlowModel, *, T: int, D: int, channels: int) -> dict[str, TracedGraph]:
    """encode, modulate and field of a flow model.

    Raises:
        ExportError: a graph cannot be traced, or holds only for the examples' sizes.
    """
    inputs = encode_inputs(model, D=D, channels=channels)
    names = tuple(spec.name for spec in inputs)
    encode = _trace(Encode(model, names), inputs, encode_outputs(model))
    context = {spec.name: spec for spec in encode.outputs}

    modulate_inputs = (TIMES, *_select(context, context_names(model, "modulate")))
    modulate = _trace(Modulate(model), modulate_inputs, ("modulation",))

    x_t = TensorSpec("x_t", F32, ("B", "N", T, 3 * D))
    size = modulate.outputs[0].shape[-1]
    one_time = TensorSpec("modulation", F32, ("B", size))
    field_inputs = (x_t, one_time, *_select(context, context_names(model, "field")))
    field = _trace(Field(model), field_inputs, ("dx_t",))
    return {"encode": encode, "modulate": modulate, "field": field}


def _trace(module: nn.Module, specs: tuple[TensorSpec, ...], outputs: Sequence[str]) -> TracedGraph:
    traced = trace(module, [_example(spec) for spec in specs], inputs=specs, outputs=outputs)
    return TracedGraph(traced, specs, output_specs(traced))


def _example(spec: TensorSpec) -> Tensor:
    """Random numbers of a tensor's shape."""
    sizes = [EXAMPLE_SIZES[axis] if isinstance(axis, str) else axis for axis in spec.shape]
    return torch.rand(sizes)


def _select(context: Mapping[str, TensorSpec], names: Iterable[str]) -> list[TensorSpec]:
    specs = [context[name] for name in names]
    for spec in specs:
        if unknown := [a for a in spec.shape if isinstance(a, str) and a not in AXES]:
            raise ExportError(
                f"context tensor {spec.name} has shape {[*spec.shape]}: "
                f"{', '.join(unknown)} is neither a number nor one of {', '.join(AXES)}"
            )
    return specs
