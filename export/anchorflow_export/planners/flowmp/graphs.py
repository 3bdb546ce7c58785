"""A flow model, graph by graph: what torch.onnx traces for each role of the bundle."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Protocol

from torch import Tensor

from anchorflow_client.contract import TensorSpec
from anchorflow_export.planners.specs import F32

Context = dict[str, Tensor]


class FlowModel(Protocol):
    """A planner of sampler kind "ode", as `anchorflow_models` writes them: an nn.Module.

    Its context_for_modulate and context_for_field name the encode outputs that each of them takes;
    see `context_names`.
    """

    @property
    def encode(self) -> Callable[..., Context]:
        """Some of ENCODE_INPUTS by name -> prior_basis [B,R,T*S], context."""
        ...

    def modulate(self, times: Tensor, context: Context) -> Tensor:
        """Flow times [K] -> modulation [B,K,M]."""
        ...

    def field(
        self, x_t: Tensor, prior_mean: Tensor, modulation: Tensor, context: Context
    ) -> Tensor:
        """States and prior means [B,N,T,S], modulation of one time [B,M] -> dx/dt [B,N,T,S]."""
        ...


PRIOR_BASIS = "prior_basis"

ENCODE_INPUTS = {
    spec.name: spec
    for spec in (
        TensorSpec("cost_map", F32, ("B", "C", "H", "W"), "", (0.0, 1.0)),
        TensorSpec("map_geometry", F32, ("B", 3), "m, m, m/cell"),
        TensorSpec("clearance_field", F32, ("B", "H", "W"), "m"),
        TensorSpec("x_curr", F32, ("B", "3D"), "m, m/s, m/s^2"),
        TensorSpec("x_goal", F32, ("B", "2D"), "m, m/s"),
        TensorSpec("w_style", F32, ("B", 3), "", (0.0, 1.0)),
        TensorSpec("limits", F32, ("B", 4), "m/s, m/s^2, m, s", (0.0, None)),
    )
}


def encode_inputs(model: FlowModel, *, D: int, channels: int) -> tuple[TensorSpec, ...]:
    """What a model's `encode` takes, by the names of its parameters."""
    sizes: dict[str | int, int] = {"C": channels, "3D": 3 * D, "2D": 2 * D}
    specs = (ENCODE_INPUTS[name] for name in inspect.signature(model.encode).parameters)
    return tuple(_sized(spec, sizes, D) for spec in specs)


def encode_outputs(model: FlowModel) -> tuple[str, ...]:
    """The prior, and what the other two graphs take of the context; each once."""
    context = (*context_names(model, "modulate"), *context_names(model, "field"))
    return tuple(dict.fromkeys((PRIOR_BASIS, *context)))


def context_names(model: FlowModel, role: str) -> tuple[str, ...]:
    """The encode outputs that "modulate" or "field" takes."""
    # Looked up by name: class attribute or property, the planners are free to choose.
    return getattr(model, f"context_for_{role}")


def unit_of(unit: str, D: int) -> str:
    """The unit of vectors of D: "m/s", or "m/s (heading: rad/s)"."""
    return unit if D == 2 else f"{unit} (heading: {unit.replace('m', 'rad')})"


def _sized(spec: TensorSpec, sizes: Mapping[str | int, int], D: int) -> TensorSpec:
    shape = tuple(sizes.get(axis, axis) for axis in spec.shape)
    unit = unit_of(spec.unit, D) if {"3D", "2D"} & {*spec.shape} else spec.unit
    return TensorSpec(spec.name, spec.dtype, shape, unit, spec.range)
