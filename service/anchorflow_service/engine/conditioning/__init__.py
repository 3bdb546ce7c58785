"""Conditioning: from a request to the inputs of the graphs, by the kind that a manifest names."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning
from anchorflow_service.engine.conditioning.tensors import TensorConditioning
from anchorflow_service.engine.parts import Conditioning

CONDITIONINGS: Mapping[str, Callable[[Manifest], Conditioning]] = {
    "cost_map": CostMapConditioning,
    "tensors": TensorConditioning,
}
