"""Read a network's weights back from the graphs of its bundle.

The exporter transposes, cuts and joins weights. To find them again, a network of the same
configuration whose weights are all different numbers is exported: where such a number stands in
its graphs, the bundle's graphs hold the weight.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import partial
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import numpy_helper
from torch import Tensor, nn

from anchorflow_export.adapter import ExportChoices, PlannerAdapter
from anchorflow_export.folded import FOLDED
from anchorflow_export.parity import TOLERANCE, Difference, prove_parity
from anchorflow_export.planners import adapter_of
from anchorflow_service.bundle import Bundle

Array = NDArray[Any]

FIRST = int(np.float32(2**23).view(np.int32))
"""Bits of the first number. From here on, floats of consecutive bits are different whole numbers
that no constant of a graph is likely to be."""
ROUNDED_TOLERANCE = 1.0
"""As `TOLERANCE`, of graphs in eight bits: they round activations too, which no weight does."""


@dataclass(frozen=True)
class WeightsRead:
    """The weights of a bundle.

    anew: what no graph holds, such as heads that only training uses: names of whole parts
    differences: between the bundle and a network with these weights
    """

    weights: dict[str, Tensor]
    anew: tuple[str, ...]
    differences: tuple[Difference, ...]


def read_weights(
    bundle: Bundle, model: nn.Module, choices: ExportChoices, *, planner: str
) -> WeightsRead:
    """Read the weights of a bundle into a network of its configuration.

    Eight-bit weights become the floats that they stand for. Batch normalisation that the exporter
    has folded into a convolution stays there.

    Raises `ExportError` if the network cannot be exported, or with the weights that were read it
    does not compute what the bundle computes.
    """
    _fold_normalisation(model)
    probe = deepcopy(model)
    places = _number(probe)
    _fold_normalisation(probe)
    last = max(int(place.max()) for place in places.values() if place.numel())
    found = np.full(last + 1 - FIRST, np.nan, np.float32)
    adapter, graphs = adapter_of(planner, probe, ExportChoices()), bundle.manifest.graphs
    for role in [each for each in adapter.roles if each in graphs]:
        traced = adapter.trace(role, graphs).model
        for numbers, held in _matched(traced, onnx.load(bundle.graph_path(role))):
            at = numbers.ravel().view(np.int32).astype(np.int64) - FIRST
            known = (at >= 0) & (at < len(found))
            found[at[known]] = held.ravel()[known]
    values = torch.from_numpy(found)
    read = {name: values[place.long() - FIRST] for name, place in places.items()}
    anew = {name for name, value in read.items() if value.isnan().any()}
    anew -= {name for name, _ in _normalisation(model)}
    state = model.state_dict()
    model.load_state_dict(
        state | {name: torch.where(v.isnan(), state[name], v) for name, v in read.items()}
    )
    adapt = partial(adapter_of, planner, model, choices)
    if planner in FOLDED:
        with torch.no_grad():
            anew -= FOLDED[planner](bundle, model, adapt)
    weights = model.state_dict()
    return WeightsRead(weights, _parts(anew, weights), _proof(adapt(), bundle))


def _proof(adapter: PlannerAdapter, bundle: Bundle) -> tuple[Difference, ...]:
    graphs = bundle.manifest.graphs.values()
    exact = all(graph.precision == "float32" for graph in graphs)
    return prove_parity(adapter, bundle, tolerance=TOLERANCE if exact else ROUNDED_TOLERANCE)


def _parts(names: Collection[str], weights: Iterable[str]) -> tuple[str, ...]:
    """Return the largest parts of a network whose weights are all among these names."""
    others = [name for name in weights if name not in names]
    found = set()
    for name in names:
        steps = name.split(".")
        parts = (".".join(steps[: k + 1]) for k in range(len(steps)))
        found.add(next(p for p in parts if not any(f"{o}.".startswith(f"{p}.") for o in others)))
    return tuple(sorted(found))


def _normalisation(model: nn.Module) -> Iterator[tuple[str, Tensor | float]]:
    """Yield what batch normalisation holds besides its bias, and the value that changes nothing."""
    for name, part in model.named_modules():
        if isinstance(part, nn.BatchNorm1d | nn.BatchNorm2d):
            # The exporter divides by sqrt(variance + eps), which is then exactly 1.
            kept = {"weight": 1.0, "running_mean": 0.0, "running_var": 1.0 - part.eps}
            yield from ((f"{name}.{each}", value) for each, value in kept.items())


def _fold_normalisation(model: nn.Module) -> None:
    state = model.state_dict()
    for name, value in _normalisation(model):
        state[name].fill_(value)


def _number(model: nn.Module) -> dict[str, Tensor]:
    """Fill a network with numbers; return their bits by the names of weights and buffers.

    Weights that are one under two names have the same numbers.
    """
    places: dict[str, Tensor] = {}
    of_storage: dict[int, Tensor] = {}
    first = FIRST
    for name, value in model.state_dict().items():
        if value.dtype != torch.float32:
            continue
        if value.data_ptr() not in of_storage:
            bits = torch.arange(first, first + value.numel(), dtype=torch.int32)
            of_storage[value.data_ptr()] = bits.reshape(value.shape)
            first += value.numel()
        places[name] = of_storage[value.data_ptr()]
        value.copy_(places[name].view(torch.float32))
    return places


def _matched(ours: onnx.ModelProto, theirs: onnx.ModelProto) -> Iterator[tuple[Array, Array]]:
    """Yield the tensors of two graphs that stand at the same place.

    Those that the exporter names after a parameter have its name in both. The others are matched in
    the order of their use; so are equal weights, of which a graph holds one under a single name.
    """
    uses = [_uses(ours), _uses(theirs)]
    held = {use.key: use.value for use in uses[1]}
    orders = [[use.kind for use in each] for each in uses]
    for block in SequenceMatcher(None, *orders, autojunk=False).get_matching_blocks():
        for k in range(block.size):
            mine, its = uses[0][block.a + k], uses[1][block.b + k]
            if not mine.is_named or mine.key not in held:
                yield mine.value, its.value
    yield from ((use.value, held[use.key]) for use in uses[0] if use.is_named and use.key in held)


@dataclass(frozen=True)
class _Use:
    """A tensor as an input of a node.

    kind: operator and shape; path: the tensor's name, within the network if it is a parameter's
    """

    kind: str
    path: str
    value: Array

    @property
    def key(self) -> str:
        return f"{self.path} {[*self.value.shape]}"

    @property
    def is_named(self) -> bool:
        """Whether the exporter named it after a parameter; what it computed has a number."""
        return "." in self.path


def _uses(model: onnx.ModelProto) -> list[_Use]:
    """Return the float tensors of a graph in the order in which nodes use them.

    Eight-bit tensors are given as the floats that they stand for.
    """
    held = {each.name: numpy_helper.to_array(each) for each in model.graph.initializer}
    names = {name: name for name in held}
    for node in model.graph.node:
        if node.op_type == "DequantizeLinear" and node.input[0] in held:
            held[node.output[0]] = _dequantised(node, held)
            names[node.output[0]] = node.input[0].removesuffix("_quantized")
    uses = []
    nodes = [each for each in model.graph.node if each.op_type != "DequantizeLinear"]
    for operator, name in ((each.op_type, name) for each in nodes for name in each.input):
        if name not in held:
            continue
        value, path = held[name], names[name]
        while path.startswith("model."):  # an adapter may hold the network within another
            path = path.removeprefix("model.")
        if value.dtype == np.float32 and (value.size > 1 or "." in path):
            uses.append(_Use(f"{operator} {[*value.shape]}", path, value))
    return uses


def _dequantised(node: onnx.NodeProto, held: Mapping[str, Array]) -> Array:
    value, scale, zero = (held[name] for name in node.input)
    axis = next((each.i for each in node.attribute if each.name == "axis"), 1)
    if scale.ndim:
        along = [-1 if k == axis % value.ndim else 1 for k in range(value.ndim)]
        scale, zero = scale.reshape(along), zero.reshape(along)
    return (value.astype(np.float32) - zero.astype(np.float32)) * scale
