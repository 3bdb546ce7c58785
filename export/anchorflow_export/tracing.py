"""Export one torch module to one ONNX graph with open axes and nothing of this machine in it."""

from __future__ import annotations

import gc
import inspect
import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import onnx
import torch
from torch import Tensor, nn
from torch.export import Dim

from anchorflow_client.contract import TensorSpec
from anchorflow_client.errors import AnchorFlowError
from anchorflow_models.torch_graphs import Role

OPSET = 20


class ExportError(AnchorFlowError):
    """A model could not be exported, or its graphs do not give what torch gives."""


@dataclass(frozen=True)
class OpenAxis:
    """An axis whose size a graph leaves open: its size in the trace, and its range."""

    example: int
    least: int = 1
    most: int = 65536


# Axes that the contract bounds, with sizes that differ in a trace.
AXES = {
    "B": OpenAxis(2, most=4096),
    "N": OpenAxis(3),
    "K": OpenAxis(5),
    "H": OpenAxis(24, least=16, most=512),
    "W": OpenAxis(20, least=16, most=512),
}
ANOTHER_AXIS = OpenAxis(7)


@dataclass(frozen=True, eq=False)
class TracedGraph:
    """An ONNX graph and its signature."""

    model: onnx.ModelProto
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]


def trace(
    module: nn.Module, *, inputs: Sequence[TensorSpec], outputs: Sequence[str]
) -> TracedGraph:
    """Export a module whose forward takes the inputs and returns the outputs in order.

    Every axis that is a letter in an input's spec is left open.

    Raises `ExportError` if the module cannot be traced, or holds only for the sizes of the trace.
    """
    name = module.role if isinstance(module, Role) else type(module).__name__
    for spec in inputs:
        _check_open_axes(spec)
    examples = [random_tensor(spec) for spec in inputs]
    try:
        with torch.no_grad(), _quiet_exporter():
            program = torch.onnx.export(
                module.eval(),
                tuple(examples),
                dynamo=True,
                opset_version=OPSET,
                input_names=[spec.name for spec in inputs],
                output_names=list(outputs),
                dynamic_shapes=_dynamic_shapes(module, inputs),
                external_data=False,
                verbose=False,
            )
    except torch.onnx.OnnxExporterError as error:
        reason = error.__cause__ or error  # torch wraps the cause in advice on reporting bugs
        raise ExportError(f"{name} cannot be traced: {reason}") from error
    assert program is not None  # None is for the exporter that dynamo=True replaces
    model = program.model_proto
    _check_axes(name, model, inputs)
    _forget_origin(model)
    onnx.checker.check_model(model, full_check=True)
    return TracedGraph(model, tuple(inputs), tuple(map(_spec, model.graph.output)))


def random_tensor(
    spec: TensorSpec,
    sizes: Mapping[str, int] | None = None,
    *,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Draw numbers of a tensor's type and range evenly; from 0 to 1 if it has no bounds.

    sizes: of open axes by letter; the others have those of a trace
    """
    known = {letter: axis.example for letter, axis in AXES.items()} | dict(sizes or {})
    shape = [known.get(a, ANOTHER_AXIS.example) if isinstance(a, str) else a for a in spec.shape]
    dtype = getattr(torch, spec.dtype)
    low, high = _bounds(spec, dtype)
    if dtype.is_floating_point:
        return low + (high - low) * torch.rand(shape, dtype=dtype, generator=generator)
    return torch.randint(int(low), int(high) + 1, shape, dtype=dtype, generator=generator)


def _bounds(spec: TensorSpec, dtype: torch.dtype) -> tuple[float, float]:
    """Return the range; a missing bound lies 1 from the other, and a byte may be any."""
    if spec.range is None and dtype == torch.uint8:
        return 0, 255
    low, high = spec.range or (None, None)
    if low is None:
        low = 0.0 if high is None else min(0.0, high - 1)
    return low, low + 1 if high is None else high


def _spec(value: onnx.ValueInfoProto) -> TensorSpec:
    tensor = value.type.tensor_type
    dtype = onnx.helper.tensor_dtype_to_np_dtype(tensor.elem_type).name
    shape = tuple(axis.dim_param or axis.dim_value for axis in tensor.shape.dim)
    return TensorSpec(value.name, dtype, shape)


def _check_open_axes(spec: TensorSpec) -> None:
    """Refuse an axis that an earlier graph computes, such as H//2: it cannot be left open."""
    for axis in spec.shape:
        if isinstance(axis, str) and not axis.isidentifier():
            raise ExportError(
                f"tensor {spec.name} has shape {[*spec.shape]}: "
                f"{axis} is neither a number nor the name of an axis"
            )


def _dynamic_shapes(module: nn.Module, inputs: Sequence[TensorSpec]) -> tuple[Any, ...]:
    """Return the open axes as torch.export takes them, with *inputs as one argument."""
    shapes = tuple(
        {i: _open(axis) for i, axis in enumerate(spec.shape) if isinstance(axis, str)}
        for spec in inputs
    )
    taken = inspect.signature(module.forward).parameters.values()
    starred = any(each.kind is inspect.Parameter.VAR_POSITIONAL for each in taken)
    return (shapes,) if starred else shapes


def _open(letter: str) -> Dim:
    axis = AXES.get(letter, ANOTHER_AXIS)
    return Dim(letter, min=axis.least, max=axis.most)


def _check_axes(name: str, model: onnx.ModelProto, inputs: Sequence[TensorSpec]) -> None:
    """Refuse a graph whose axis the module has fixed, which the exporter does silently."""
    for value, spec in zip(model.graph.input, inputs, strict=True):
        shape = _spec(value).shape
        if shape != spec.shape:
            raise ExportError(
                f"{name}: input {spec.name} came out as {[*shape]}, expected {[*spec.shape]}; "
                "the module holds for the example's sizes only"
            )


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Silence warnings of torch about itself; collect no garbage, a fifth of a trace's time."""
    collects = gc.isenabled()
    gc.disable()
    registry = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = registry.level
    registry.setLevel(logging.ERROR)  # it warns that torchvision is missing
    try:
        with warnings.catch_warnings():
            # Torch uses an API that it deprecates.
            warnings.filterwarnings("ignore", message=".*LeafSpec.*", category=FutureWarning)
            # Several inputs share an axis on purpose.
            warnings.filterwarnings("ignore", message=r"# The axis name: \w+ will not be used")
            yield
    finally:
        registry.setLevel(level)
        if collects:
            gc.enable()


def _forget_origin(model: onnx.ModelProto) -> None:
    """Drop the source file names that the exporter writes on every part of a graph."""
    graph = model.graph
    values = (*graph.input, *graph.output, *graph.value_info, *graph.initializer)
    for part in (model, graph, *graph.node, *values):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
