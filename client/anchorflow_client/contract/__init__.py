"""The contract: what goes into AnchorFlow and what comes out, for client and service alike."""

from anchorflow_client.contract.batch import AnchorBatch
from anchorflow_client.contract.card import MapSpec, ModelCard, ModelId, TensorSpec
from anchorflow_client.contract.cost_map import CostMap
from anchorflow_client.contract.ranges import (
    DEFAULT_NUM_SAMPLES,
    DEFAULT_STYLE,
    EIGHT_STEP_SCHEDULE,
    MAX_MAP_CELLS,
    METHODS,
    MIN_MAP_CELLS,
    OCCUPIED,
)
from anchorflow_client.contract.request import AnchorRequest
from anchorflow_client.contract.resolve import ResolvedRequest, resolve_for_card
from anchorflow_client.contract.sampling import (
    RefineChoice,
    RefineSpec,
    SamplerChoice,
    SamplerSpec,
    WarmStart,
    uniform_schedule,
)

__all__ = [
    "DEFAULT_NUM_SAMPLES",
    "DEFAULT_STYLE",
    "EIGHT_STEP_SCHEDULE",
    "MAX_MAP_CELLS",
    "METHODS",
    "MIN_MAP_CELLS",
    "OCCUPIED",
    "AnchorBatch",
    "AnchorRequest",
    "CostMap",
    "MapSpec",
    "ModelCard",
    "ModelId",
    "RefineChoice",
    "RefineSpec",
    "ResolvedRequest",
    "SamplerChoice",
    "SamplerSpec",
    "TensorSpec",
    "WarmStart",
    "resolve_for_card",
    "uniform_schedule",
]
