"""AnchorFlow's contract and clients, for robots: needs numpy and the standard library alone.

from anchorflow_client import AnchorClient

with AnchorClient("http://127.0.0.1:8000") as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)
"""

from anchorflow_client.base_client import BaseAsyncClient, BaseClient
from anchorflow_client.cancellation import Cancellation
from anchorflow_client.codec import Codec, JsonCodec, Payload
from anchorflow_client.contract import (
    STYLES,
    AnchorBatch,
    AnchorRequest,
    AnswerSpec,
    CostMap,
    CostMapSpec,
    EncodedImage,
    GoalTolerance,
    LimitsSpec,
    ModelCard,
    ModelId,
    NoFinish,
    OdeSpec,
    RefineChoice,
    RefineSpec,
    SamplerChoice,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    TruncatedDiffusionSpec,
    VisionLanguageSpec,
    VocabularySpec,
    WarmStart,
)
from anchorflow_client.contract.ros_grid import RosGrid
from anchorflow_client.errors import (
    AnchorFlowError,
    Cancelled,
    ConnectionFailed,
    DeadlineExceeded,
    InternalError,
    InvalidAnswer,
    InvalidRequest,
    NotReady,
    Overloaded,
    RequestError,
    Superseded,
    TimedOut,
    TooLarge,
    TransportError,
    Unauthorized,
    UnknownModel,
)
from anchorflow_client.http import AnchorClient, AsyncAnchorClient
from anchorflow_client.http.transport import AsyncTransport, Transport
from anchorflow_client.oip_codec import OipCodec
from anchorflow_client.planner import Plan, Planner, PlannerConfig, PlanState
from anchorflow_client.resampling import ResampledAnchor, resample
from anchorflow_client.retry import AsyncRetryingClient, RetryingClient

__all__ = [
    "STYLES",
    "AnchorBatch",
    "AnchorClient",
    "AnchorFlowError",
    "AnchorRequest",
    "AnswerSpec",
    "AsyncAnchorClient",
    "AsyncRetryingClient",
    "AsyncTransport",
    "BaseAsyncClient",
    "BaseClient",
    "Cancellation",
    "Cancelled",
    "Codec",
    "ConnectionFailed",
    "CostMap",
    "CostMapSpec",
    "DeadlineExceeded",
    "EncodedImage",
    "GoalTolerance",
    "InternalError",
    "InvalidAnswer",
    "InvalidRequest",
    "JsonCodec",
    "LimitsSpec",
    "ModelCard",
    "ModelId",
    "NoFinish",
    "NotReady",
    "OdeSpec",
    "OipCodec",
    "Overloaded",
    "Payload",
    "Plan",
    "PlanState",
    "Planner",
    "PlannerConfig",
    "RefineChoice",
    "RefineSpec",
    "RequestError",
    "ResampledAnchor",
    "RetryingClient",
    "RosGrid",
    "SamplerChoice",
    "Superseded",
    "TensorSpec",
    "TensorsSpec",
    "TimeSpec",
    "TimedOut",
    "TooLarge",
    "Transport",
    "TransportError",
    "TruncatedDiffusionSpec",
    "Unauthorized",
    "UnknownModel",
    "VisionLanguageSpec",
    "VocabularySpec",
    "WarmStart",
    "resample",
]
