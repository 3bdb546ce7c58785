"""From a request's bytes to its answer's, for every transport.

service  decodes a call, chooses the engine, queues the planning, encodes the answer
call     a request as its transport received it, its deadline, and the observers of its outcome
engines  the engines that are served, by model name
queue    admission, micro-batches and the lanes that plan
job      work that waits in line and runs, unless it is cancelled
"""

from anchorflow_service.planning.job import (
    ANSWERED,
    CANCELLED,
    Arrival,
    Call,
    JobContext,
    Observer,
    internal_error,
)
from anchorflow_service.planning.queue import PlanningQueue, ServiceLimits
from anchorflow_service.planning.service import EngineRegistry, PlanningEngine, PlanningService

__all__ = [
    "ANSWERED",
    "CANCELLED",
    "Arrival",
    "Call",
    "EngineRegistry",
    "JobContext",
    "Observer",
    "PlanningEngine",
    "PlanningQueue",
    "PlanningService",
    "ServiceLimits",
    "internal_error",
]
