"""The contract: what goes into AnchorFlow and what comes out, for client and service alike."""

from anchorflow_client.contract.batch import AnchorBatch as AnchorBatch
from anchorflow_client.contract.body import Kinematics as Kinematics
from anchorflow_client.contract.card import (
    AnswerSpec as AnswerSpec,
    CostMapSpec as CostMapSpec,
    GuardSpec as GuardSpec,
    LimitsSpec as LimitsSpec,
    ModelCard as ModelCard,
    ModelId as ModelId,
    NoFinish as NoFinish,
    OdeSpec as OdeSpec,
    RefineSpec as RefineSpec,
    TensorSpec as TensorSpec,
    TensorsSpec as TensorsSpec,
    TimeSpec as TimeSpec,
    TruncatedDiffusionSpec as TruncatedDiffusionSpec,
    VisionLanguageSpec as VisionLanguageSpec,
    VocabularySpec as VocabularySpec,
)
from anchorflow_client.contract.cost_map import CostMap as CostMap
from anchorflow_client.contract.fields import (
    DEFAULT_NUM_SAMPLES as DEFAULT_NUM_SAMPLES,
    DEFAULT_STYLE as DEFAULT_STYLE,
    MAX_MAP_CELLS as MAX_MAP_CELLS,
    METHODS as METHODS,
    MIN_MAP_CELLS as MIN_MAP_CELLS,
    OCCUPIED as OCCUPIED,
    STYLES as STYLES,
    GoalTolerance as GoalTolerance,
    RefineChoice as RefineChoice,
    SamplerChoice as SamplerChoice,
    WarmStart as WarmStart,
)
from anchorflow_client.contract.inputs import EncodedImage as EncodedImage
from anchorflow_client.contract.obstacles import Obstacles as Obstacles
from anchorflow_client.contract.request import AnchorRequest as AnchorRequest
from anchorflow_client.contract.resolve import (
    ResolvedRequest as ResolvedRequest,
    resolve_for_card as resolve_for_card,
)
from anchorflow_client.contract.rows import (
    EIGHT_STEP_SCHEDULE as EIGHT_STEP_SCHEDULE,
    uniform_schedule as uniform_schedule,
)
