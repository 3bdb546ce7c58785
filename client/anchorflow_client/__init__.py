"""AnchorFlow's contract and clients, for robots: needs numpy and the standard library alone.

from anchorflow_client import AnchorClient

with AnchorClient("http://127.0.0.1:8000") as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from anchorflow_client.base_client import (
    BaseAsyncClient as BaseAsyncClient,
    BaseClient as BaseClient,
)
from anchorflow_client.cancellation import Cancellation as Cancellation
from anchorflow_client.codec import (
    Codec as Codec,
    JsonCodec as JsonCodec,
    Payload as Payload,
)
from anchorflow_client.contract import (
    STYLES as STYLES,
    AnchorBatch as AnchorBatch,
    AnchorRequest as AnchorRequest,
    AnswerSpec as AnswerSpec,
    CostMap as CostMap,
    CostMapSpec as CostMapSpec,
    EncodedImage as EncodedImage,
    GoalTolerance as GoalTolerance,
    GuardSpec as GuardSpec,
    LimitsSpec as LimitsSpec,
    ModelCard as ModelCard,
    ModelId as ModelId,
    NoFinish as NoFinish,
    Obstacles as Obstacles,
    OdeSpec as OdeSpec,
    RefineChoice as RefineChoice,
    RefineSpec as RefineSpec,
    SamplerChoice as SamplerChoice,
    TensorSpec as TensorSpec,
    TensorsSpec as TensorsSpec,
    TimeSpec as TimeSpec,
    TruncatedDiffusionSpec as TruncatedDiffusionSpec,
    VisionLanguageSpec as VisionLanguageSpec,
    VocabularySpec as VocabularySpec,
    WarmStart as WarmStart,
)
from anchorflow_client.contract.ros_grid import RosGrid as RosGrid
from anchorflow_client.errors import (
    AnchorFlowError as AnchorFlowError,
    Cancelled as Cancelled,
    ConnectionFailed as ConnectionFailed,
    DeadlineExceeded as DeadlineExceeded,
    InternalError as InternalError,
    InvalidAnswer as InvalidAnswer,
    InvalidRequest as InvalidRequest,
    NotReady as NotReady,
    Overloaded as Overloaded,
    RequestError as RequestError,
    Superseded as Superseded,
    TimedOut as TimedOut,
    TooLarge as TooLarge,
    TransportError as TransportError,
    Unauthorized as Unauthorized,
    UnknownModel as UnknownModel,
    UsageError as UsageError,
    how_to_install,
)
from anchorflow_client.http import (
    AnchorClient as AnchorClient,
    AsyncAnchorClient as AsyncAnchorClient,
)
from anchorflow_client.http.transport import (
    AsyncTransport as AsyncTransport,
    Transport as Transport,
)
from anchorflow_client.oip_codec import OipCodec as OipCodec
from anchorflow_client.planner import (
    Plan as Plan,
    Planner as Planner,
    PlannerConfig as PlannerConfig,
    PlanState as PlanState,
)
from anchorflow_client.resampling import ResampledAnchor as ResampledAnchor, resample as resample
from anchorflow_client.retry import (
    AsyncRetryingClient as AsyncRetryingClient,
    RetryingClient as RetryingClient,
)

__version__ = "0.1.0"
"""Of every distribution that is built from this repository."""

if TYPE_CHECKING:
    from anchorflow_client.zenoh_client import (
        AsyncZenohAnchorClient as AsyncZenohAnchorClient,
        ZenohAnchorClient as ZenohAnchorClient,
    )


def __getattr__(name: str) -> Any:
    """Import the clients over zenoh when they are first named: a base install has no zenoh."""
    if name not in ("ZenohAnchorClient", "AsyncZenohAnchorClient"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module("anchorflow_client.zenoh_client"), name)
    except ModuleNotFoundError as error:
        if error.name != "zenoh":
            raise
        raise ImportError(
            f"{name} needs zenoh, which is not installed: {how_to_install('zenoh')}"
        ) from error
