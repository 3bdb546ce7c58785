"""From a request's bytes to its answer's: the one way in which every transport has anchors planned.

service           the way: decode, choose the engine, resolve, budget, queue, plan, encode
call              a request as its transport received it
arrival           the caller's time
engines           what is served, by model name
latest_per_robot  the latest request of a robot wins
queue             so many at a time in micro-batches, so many waiting, the rest refused
waiting           the line of jobs that wait, and the batch at its head
job               work that waits and is done, unless nobody waits for it any more
service_time      how long a request takes, and therefore the wait
limits            the bounds
observer          who hears what becomes of every call
"""

from anchorflow_service.planning.arrival import Arrival
from anchorflow_service.planning.call import Call
from anchorflow_service.planning.engines import EngineRegistry, PlanningEngine
from anchorflow_service.planning.errors import internal_error
from anchorflow_service.planning.job import JobContext
from anchorflow_service.planning.limits import ServiceLimits
from anchorflow_service.planning.observer import ANSWERED, CANCELLED, Observer
from anchorflow_service.planning.queue import PlanningQueue
from anchorflow_service.planning.service import PlanningService

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
