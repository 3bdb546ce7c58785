"""The contract: what goes into AnchorFlow and what comes out, for client and service alike."""

from anchorflow_client.contract.batch import AnchorBatch
from anchorflow_client.contract.card import ModelCard, ModelId
from anchorflow_client.contract.cost_map import CostMap
from anchorflow_client.contract.fields import (
    DEFAULT_NUM_SAMPLES,
    DEFAULT_STYLE,
    MAX_MAP_CELLS,
    METHODS,
    MIN_MAP_CELLS,
    OCCUPIED,
    STYLES,
    GoalTolerance,
    RefineChoice,
    SamplerChoice,
    WarmStart,
)
from anchorflow_client.contract.inputs import EncodedImage
from anchorflow_client.contract.kinds import (
    AnswerSpec,
    CostMapSpec,
    LimitsSpec,
    NoFinish,
    OdeSpec,
    RefineSpec,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    TruncatedDiffusionSpec,
    VisionLanguageSpec,
    VocabularySpec,
)
from anchorflow_client.contract.request import AnchorRequest
from anchorflow_client.contract.resolve import ResolvedRequest, resolve_for_card
from anchorflow_client.contract.rows import EIGHT_STEP_SCHEDULE, uniform_schedule

__all__ = [
    "DEFAULT_NUM_SAMPLES",
    "DEFAULT_STYLE",
    "EIGHT_STEP_SCHEDULE",
    "MAX_MAP_CELLS",
    "METHODS",
    "MIN_MAP_CELLS",
    "OCCUPIED",
    "STYLES",
    "AnchorBatch",
    "AnchorRequest",
    "AnswerSpec",
    "CostMap",
    "CostMapSpec",
    "EncodedImage",
    "GoalTolerance",
    "LimitsSpec",
    "ModelCard",
    "ModelId",
    "NoFinish",
    "OdeSpec",
    "RefineChoice",
    "RefineSpec",
    "ResolvedRequest",
    "SamplerChoice",
    "TensorSpec",
    "TensorsSpec",
    "TimeSpec",
    "TruncatedDiffusionSpec",
    "VisionLanguageSpec",
    "VocabularySpec",
    "WarmStart",
    "resolve_for_card",
    "uniform_schedule",
]
