"""From a request's bytes to its answer's: the one way in which every transport has anchors planned.

service     the way: decode, choose the engine, resolve, budget, queue, plan, encode
arrival     the caller's time
engines     what is served, by model name
robots      the latest request of a robot wins
queue       so many at a time in micro-batches, so many waiting, the rest refused
waiting     the line of those who wait, and the batch at its head
ticket      one who waits, until there is an answer or nobody waits for it
pace        how long a request takes, and therefore the wait
limits      the bounds
observer    who hears what becomes of every call
"""

from anchorflow_service.planning.arrival import Arrival
from anchorflow_service.planning.engines import Engine, Engines
from anchorflow_service.planning.errors import internal_error
from anchorflow_service.planning.job import Turn
from anchorflow_service.planning.limits import ServiceLimits
from anchorflow_service.planning.observer import ANSWERED, CANCELLED, Observer
from anchorflow_service.planning.queue import PlanningQueue
from anchorflow_service.planning.service import Call, PlanningService

__all__ = [
    "ANSWERED",
    "CANCELLED",
    "Arrival",
    "Call",
    "Engine",
    "Engines",
    "Observer",
    "PlanningQueue",
    "PlanningService",
    "ServiceLimits",
    "Turn",
    "internal_error",
]
