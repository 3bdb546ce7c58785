"""What may be set of a `Planner`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from anchorflow_client.contract import ranges
from anchorflow_client.contract.checks import is_number
from anchorflow_client.contract.ranges import Interval

PERIOD = Interval(0.0, math.inf, "ms", open_low=True, open_high=True)
INTERVALS = {
    "max_age_ms": ranges.BUDGET,
    "period_ms": PERIOD,
    "first_retry_ms": PERIOD,
    "longest_retry_ms": PERIOD,
    "margin_m": ranges.CERTIFIED_MARGIN,
    "switch_gain": Interval(0.0, math.inf),
    "stuck_s": Interval(0.0, math.inf, "s", open_low=True),
    "stuck_m": Interval(0.0, math.inf, "m"),
    "goal_clearance_m": Interval(0.0, math.inf, "m", open_high=True),
    "through_speed": Interval(0.0, ranges.VELOCITY.high, "m/s"),
    "warm_tau": ranges.INSIDE_UNIT,
}
"""What each number of a `PlannerConfig` may be."""


@dataclass(frozen=True, kw_only=True)
class PlannerConfig:
    """How often to ask, how old a plan may grow, and what is added to what the loop sees."""

    max_age_ms: float = 1000.0
    """From when a plan is expired and a request is given up; also each request's budget_ms."""
    period_ms: float = 100.0
    """Least time between two requests."""
    first_retry_ms: float = 100.0
    """Wait after a failure; it doubles from one failure to the next."""
    longest_retry_ms: float = 500.0
    margin_m: float = 0.0
    """Beyond the robot's radius, that what follows the anchors asks for. It is sent as
    `refine.certified_margin`, so that an anchor is safe where the robot may drive along it; less
    of it where the robot already stands nearer to an obstacle."""
    switch_gain: float = 0.15
    """Share of its cost by which another route has to be better than the one in use."""
    stuck_s: float = 5.0
    """From when a robot with a plan that stays within `stuck_m` m of a place is stuck."""
    stuck_m: float = 0.5
    """m; for a slow robot no more than a tenth of what it drives in `stuck_s` at its `v_max`."""
    goal_clearance_m: float = 0.35
    """m from the local goal to the centres of occupied cells and to the map's edge; more where the
    service asks for more of a robot of that radius, as the request or the card says it."""
    through_speed: float = 1.0
    """m/s at a local goal that stands in for one beyond the map; at most the request's `v_max` or,
    where it says none, the one on the model's card. 0 within 1 m of where nothing was safe."""
    warm_tau: float = ranges.DEFAULT_TAU
    """Flow time at which a warm start enters, in (0, 1)."""
    cold_every: int = 3
    """Every how many requests one starts from noise, to find other ways; 1: every request."""

    def __post_init__(self) -> None:
        """Raises `ValueError` where a setting is out of range."""
        for name, interval in INTERVALS.items():
            value = getattr(self, name)
            if not is_number(value) or not interval.holds(value):
                raise ValueError(f"{name}: expected a number {interval}, got {value!r}")
            object.__setattr__(self, name, float(value))  # float32 rounds the time in s to minutes
        if not isinstance(self.cold_every, int) or self.cold_every < 1:
            raise ValueError(f"cold_every: expected an integer from 1, got {self.cold_every!r}")
