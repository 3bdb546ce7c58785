"""A planner for control loops.

planner     sends requests in the background and never blocks the loop
config      the settings, and when the next request is due
request     turns an observation into a request
local_goal  where to plan to on a map that may end before the goal
routes      which anchors take the same route, and when to leave the one in use
plan        the newest finished batch, and how it looks as time passes
"""

from anchorflow_client.planner.config import PlannerConfig as PlannerConfig
from anchorflow_client.planner.plan import Plan as Plan, PlanState as PlanState
from anchorflow_client.planner.planner import Planner as Planner
from anchorflow_client.planner.request import AnchorSource as AnchorSource
