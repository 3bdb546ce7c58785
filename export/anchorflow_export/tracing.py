"""One torch module to one ONNX graph, with its axes left open and nothing of this machine in it."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import onnx
import torch
from torch import Tensor, nn
from torch.export import Dim

from anchorflow_client.contract import TensorSpec
from anchorflow_export.errors import ExportError

OPSET = 20

# The open axes and how far the contract lets them reach.
AXES = {
    "B": Dim("B", min=1, max=4096),
    "N": Dim("N", min=1, max=65536),
    "K": Dim("K", min=1, max=65536),
    "H": Dim("H", min=16, max=512),
    "W": Dim("W", min=16, max=512),
}


def trace(
    module: nn.Module,
    examples: Sequence[Tensor],
    *,
    inputs: Sequence[TensorSpec],
    outputs: Sequence[str],
) -> onnx.ModelProto:
    """The ONNX graph of a module whose forward takes *inputs.

    examples: one for each input; every axis that is a letter in the input's spec is left open

    Raises:
        ExportError: the module cannot be traced, or holds only for the sizes of the examples.
    """
    try:
        with torch.no_grad(), _quiet_exporter():
            program = torch.onnx.export(
                module.eval(),
                tuple(examples),
                dynamo=True,
                opset_version=OPSET,
                input_names=[spec.name for spec in inputs],
                output_names=list(outputs),
                dynamic_shapes=(tuple(_open_axes(spec) for spec in inputs),),
                external_data=False,
                verbose=False,
            )
    except torch.onnx.OnnxExporterError as error:
        reason = error.__cause__ or error  # torch wraps the cause in advice on reporting bugs
        raise ExportError(f"{type(module).__name__} cannot be traced: {reason}") from error
    assert program is not None  # None is for the exporter that dynamo=True replaces
    model = program.model_proto
    _check_axes(type(module).__name__, model, inputs)
    _forget_origin(model)
    onnx.checker.check_model(model, full_check=True)
    return model


def output_specs(model: onnx.ModelProto) -> tuple[TensorSpec, ...]:
    """The outputs of a graph; axes that depend on the inputs' are strings."""
    return tuple(_spec(value) for value in model.graph.output)


def _spec(value: onnx.ValueInfoProto) -> TensorSpec:
    tensor = value.type.tensor_type
    dtype = onnx.helper.tensor_dtype_to_np_dtype(tensor.elem_type).name
    shape = tuple(axis.dim_param or axis.dim_value for axis in tensor.shape.dim)
    return TensorSpec(value.name, dtype, shape)


def _open_axes(spec: TensorSpec) -> dict[int, Dim]:
    return {i: AXES[axis] for i, axis in enumerate(spec.shape) if isinstance(axis, str)}


def _check_axes(name: str, model: onnx.ModelProto, inputs: Sequence[TensorSpec]) -> None:
    """The exporter closes an axis that the module fixes, and says nothing."""
    for value, spec in zip(model.graph.input, inputs, strict=True):
        shape = _spec(value).shape
        if shape != spec.shape:
            raise ExportError(
                f"{name}: input {spec.name} came out as {[*shape]}, expected {[*spec.shape]}; "
                "the module holds for the example's sizes only"
            )


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Without what torch has to say of itself."""
    registry = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = registry.level
    registry.setLevel(logging.ERROR)  # it warns that torchvision is not there
    try:
        with warnings.catch_warnings():
            # torch's own use of an API that it deprecates.
            warnings.filterwarnings("ignore", message=".*LeafSpec.*", category=FutureWarning)
            # Several inputs share an axis on purpose.
            warnings.filterwarnings("ignore", message=r"# The axis name: \w+ will not be used")
            yield
    finally:
        registry.setLevel(level)


def _forget_origin(model: onnx.ModelProto) -> None:
    """Drop the traces of source files that the exporter leaves on every part of a graph."""
    graph = model.graph
    values = (*graph.input, *graph.output, *graph.value_info, *graph.initializer)
    for part in (model, graph, *graph.node, *values):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
