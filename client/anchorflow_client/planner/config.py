"""The settings of a `Planner`, and when they let it send a request."""

from __future__ import annotations

import math
from dataclasses import dataclass

from anchorflow_client.contract import fields as ranges
from anchorflow_client.contract.checks import Interval, is_number
from anchorflow_client.errors import AnchorFlowError, InvalidRequest, UsageError
from anchorflow_client.retry_policy import at_least_retry_after, exponential_backoff

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
"""The range of each number of a `PlannerConfig`."""


@dataclass(frozen=True, kw_only=True)
class PlannerConfig:
    """How often to send requests, how old a plan may grow, and how requests are completed."""

    max_age_ms: float = 1000.0
    """Age at which a plan expires and a request is given up; also each request's budget_ms."""
    period_ms: float = 100.0
    """Shortest time between two requests."""
    first_retry_ms: float = 100.0
    """Wait after a failure; it doubles from one failure to the next."""
    longest_retry_ms: float = 500.0
    margin_m: float = 0.0
    """Clearance beyond the robot's radius that the controller needs. It is sent as
    `refine.certified_margin`, so that an anchor is safe only if the robot may drive along it; less
    is sent if the robot already stands nearer to an obstacle."""
    switch_gain: float = 0.15
    """Share of its cost by which another route has to be better than the one in use."""
    stuck_s: float = 5.0
    """Time after which a robot with a plan that stays within `stuck_m` m of a place is stuck."""
    stuck_m: float = 0.5
    """m; for a slow robot no more than a tenth of what it drives in `stuck_s` at its `v_max`."""
    goal_clearance_m: float = 0.35
    """m from the local goal to the centres of occupied cells and to the map's edge; more if the
    service requires more for a robot of that radius, given by the request or the card."""
    through_speed: float = 1.0
    """m/s at a local goal that replaces one beyond the map; at most the request's `v_max` or, if
    it has none, the one on the model's card. 0 within 1 m of a place where nothing was safe."""
    warm_tau: float = ranges.DEFAULT_TAU
    """Flow time at which a warm start enters, in (0, 1)."""
    cold_every: int = 3
    """Every how many requests one starts from noise, to find other ways; 1: every request."""

    def __post_init__(self) -> None:
        """Raise `UsageError` if a setting is out of range."""
        for name, interval in INTERVALS.items():
            value = getattr(self, name)
            if not is_number(value) or not interval.holds(value):
                raise UsageError(f"{name}: expected a number {interval}, got {value!r}")
            object.__setattr__(self, name, float(value))  # float32 rounds the time in s to minutes
        if not isinstance(self.cold_every, int) or self.cold_every < 1:
            raise UsageError(f"cold_every: expected an integer from 1, got {self.cold_every!r}")


class Pacing:
    """Decides when the next request is due, in s of the planner's clock."""

    def __init__(self, config: PlannerConfig) -> None:
        self._config = config
        self._not_before = -float("inf")
        self.answered()

    def is_due(self, now: float) -> bool:
        return now >= self._not_before

    def sent(self, at: float) -> None:
        """Note that a request was sent for an observation of that time."""
        self._not_before = at + 1e-3 * self._config.period_ms

    def answered(self) -> None:
        """Note an answer: the next failure is the first."""
        config = self._config
        self._pauses_ms = exponential_backoff(config.first_retry_ms, config.longest_retry_ms)

    def failed(self, error: AnchorFlowError, now: float) -> None:
        if isinstance(error, InvalidRequest):
            return  # the service works, and the next observation may be valid
        wait_s = at_least_retry_after(1e-3 * next(self._pauses_ms), error)
        self._not_before = max(self._not_before, now + wait_s)
