"""Conditioning: reads a request into the inputs of the graphs, by the kind in the manifest."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from anchorflow_service.bundle import Bundle
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning
from anchorflow_service.engine.conditioning.tensors import TensorConditioning
from anchorflow_service.engine.conditioning.vision_language import VisionLanguageConditioning
from anchorflow_service.engine.interfaces import Conditioning

CONDITIONINGS: Mapping[str, Callable[[Bundle], Conditioning]] = {
    "cost_map": lambda bundle: CostMapConditioning(bundle.manifest),
    "tensors": lambda bundle: TensorConditioning(bundle.manifest),
    "vision_language": VisionLanguageConditioning,
}
