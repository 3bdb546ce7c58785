"""From a request's bytes to its answer's, for every transport.

service  decodes a call, chooses the engine, queues the planning, encodes the answer
queue    admission, micro-batches and the lanes that plan
job      a call as its transport received it, and the work that waits in line for it
"""

from anchorflow_service.planning.job import (
    ANSWERED as ANSWERED,
    CANCELLED as CANCELLED,
    Arrival as Arrival,
    Call as Call,
    JobContext as JobContext,
    Observer as Observer,
    internal_error as internal_error,
)
from anchorflow_service.planning.queue import (
    PlanningQueue as PlanningQueue,
    ServiceLimits as ServiceLimits,
)
from anchorflow_service.planning.service import (
    EngineRegistry as EngineRegistry,
    PlanningEngine as PlanningEngine,
    PlanningService as PlanningService,
)
