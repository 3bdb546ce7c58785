"""The ranges of the numbers of a request, with their units, each written once."""

from __future__ import annotations

import math

from anchorflow_client.contract.checks import Interval

UNIT = Interval(0.0, 1.0)
INSIDE_UNIT = Interval(0.0, 1.0, open_low=True, open_high=True)
COORDINATE = Interval(-1e7, 1e7, "m")
RESOLUTION = Interval(1e-6, 100.0, "m/cell")
ROBOT_RADIUS = Interval(0.0, 5.0, "m")
V_MAX = Interval(0.0, 100.0, "m/s", open_low=True)
A_MAX = Interval(0.0, 1000.0, "m/s^2", open_low=True)
VELOCITY = Interval(-V_MAX.high, V_MAX.high, V_MAX.unit)
ACCELERATION = Interval(-100.0, 100.0, A_MAX.unit)
STATE = (COORDINATE, VELOCITY, ACCELERATION)
"""The range of each D-vector of `x_curr` and `x_goal`; headings are in rad."""
OBSTACLE_RADIUS = Interval(0.0, 100.0, "m")
GROWTH = Interval(0.0, 100.0, "m/s")
FORECAST_DT = Interval(1e-3, 600.0, "s")
BODY_COORDINATE = Interval(-20.0, 20.0, "m")
TURNING_RADIUS = Interval(0.0, 100.0, "m")
OMEGA_MAX = Interval(0.0, 100.0, "rad/s", open_low=True)
HORIZON = Interval(0.0, 600.0, "s", open_low=True)
DELAY = Interval(0.0, 1.0, "s")
GUIDANCE = Interval(0.0, 100.0)
CHANNEL_WEIGHT = Interval(0.0, 100.0)
COST_PENALTY = Interval(0.0, 100.0)
GOAL_DISTANCE = Interval(0.0, 100.0, "m")
GOAL_TURN = Interval(0.0, math.pi, "rad")
CERTIFIED_MARGIN = Interval(0.0, 5.0, "m")
BUDGET = Interval(0.0, 1e7, "ms", open_low=True)
NUM_SAMPLES = Interval(1, 512)
STYLE_WEIGHT = Interval(0.0, 1e6)
WARM_STATE = Interval(-1e7, 1e7)
SEED = Interval(0, 2**63 - 1)
