"""A planner for control loops, and what it hands to them.

planner      asks in the background and never makes the loop wait
config       how often is asked, how old a plan may grow, how a request is filled in
pacing       when the next request is due
request      from what the loop sees to what is sent
in_flight    who is asked, a request on its way, and the answer that came of one
routes       which anchors of an answer take the same route
commitment   stays on a route until another is better by a margin
progress     whether the robot gets anywhere
local_goal   where to plan to on a map that may end before the goal
clearance    how much room a place has, as the service measures it
robot_limits how fast and how wide the robot is
plan         the newest finished batch, and how good it still is
shift        an anchor as it looks from a later moment
"""

from anchorflow_client.planner.config import PlannerConfig
from anchorflow_client.planner.in_flight import AnchorSource
from anchorflow_client.planner.plan import Plan, PlanState
from anchorflow_client.planner.planner import Planner

__all__ = ["AnchorSource", "Plan", "PlanState", "Planner", "PlannerConfig"]
