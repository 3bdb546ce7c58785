"""The graphs of a network in torch, run by role as a service runs a bundle's.

`TorchGraphs` takes and returns numpy arrays, so that samplers written for a bundle's graphs run a
network that was never exported. `Role` is one of its graphs, which the exporter traces too.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

Array = NDArray[Any]
CPU = torch.device("cpu")


class Role(nn.Module):
    """A method of a network as a graph: named tensors in, named tensors out.

    A tensor is passed to the parameter of its name, the others as the parameter `context`, if there
    is one. A method that returns one tensor gives the first of the outputs.

    inputs: names, in the order in which `forward` takes them
    outputs: names, in the order in which `forward` returns them
    """

    def __init__(
        self, model: Any, role: str, *, inputs: Sequence[str] = (), outputs: Sequence[str] = ()
    ) -> None:
        super().__init__()
        self.model, self.role = model, role
        self.inputs: tuple[str, ...] = tuple(inputs)
        self.outputs: tuple[str, ...] = tuple(outputs)
        parameters = inspect.signature(getattr(model, role)).parameters
        self.takes_all = any(each.kind is each.VAR_KEYWORD for each in parameters.values())
        self.has_context = "context" in parameters and not self.takes_all
        self.named = {*parameters} - {"context"}

    def select(self, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Return those of the arrays that the method takes."""
        if self.inputs:
            return {name: arrays[name] for name in self.inputs if name in arrays}
        if self.takes_all or self.has_context:
            return dict(arrays)
        return {name: each for name, each in arrays.items() if name in self.named}

    def run(self, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Call the method on those of the tensors that it takes."""
        taken = self.select(tensors)
        given: dict[str, Any] = {
            name: each for name, each in taken.items() if self.takes_all or name in self.named
        }
        if self.has_context:
            given["context"] = {name: each for name, each in taken.items() if name not in given}
        made = getattr(self.model, self.role)(**given)
        return {self.outputs[0]: made} if isinstance(made, Tensor) else made

    def forward(self, *inputs: Tensor) -> Tensor | tuple[Tensor, ...]:
        """Take the inputs and return the outputs in order, as torch.onnx traces them."""
        made = self.run(dict(zip(self.inputs, inputs, strict=True)))
        first, *others = (made[name] for name in self.outputs)
        return (first, *others) if others else first


@dataclass(frozen=True, eq=False)
class TorchGraphs:
    """A network's graphs, by role.

    place: the torch device of the network's tensors
    """

    roles: Mapping[str, Role]
    place: torch.device = CPU
    device: None = None
    """A device that onnxruntime computes on, which torch does not need."""

    @torch.no_grad()
    def run(self, role: str, inputs: Mapping[str, Array], *, threads: int = 1) -> dict[str, Array]:  # noqa: ARG002 - torch has its own threads
        """Run a graph on those of the inputs that it takes; return its outputs as arrays."""
        outputs = self.roles[role].run(self._tensors(self.select(role, inputs)))
        return {name: tensor.contiguous().cpu().numpy() for name, tensor in outputs.items()}

    def bind(self, role: str, inputs: Mapping[str, Array]) -> Callable[..., None]:
        """Fix some inputs of a graph for a loop that writes the outputs into its own arrays."""
        graph, fixed = self.roles[role], self._tensors(self.select(role, inputs))

        @torch.no_grad()
        def call(inputs: Mapping[str, Array], *, outputs: Mapping[str, Array]) -> None:
            made = graph.run({**fixed, **self._tensors(inputs)})
            for name, array in outputs.items():
                array[...] = made[name].cpu().numpy()

        return call

    def select(self, role: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Return those of the arrays that a graph takes by name."""
        return self.roles[role].select(arrays)

    def settle(self, role: str, inputs: Mapping[str, Array]) -> dict[str, Array]:
        """Return the outputs; torch decides on its threads itself."""
        return self.run(role, inputs)

    def _tensors(self, arrays: Mapping[str, Array]) -> dict[str, Tensor]:
        return {name: self._tensor(array) for name, array in arrays.items()}

    def _tensor(self, array: Array) -> Tensor:
        own = np.ascontiguousarray(array).reshape(array.shape)
        return torch.from_numpy(own if own.flags.writeable else own.copy()).to(self.place)
