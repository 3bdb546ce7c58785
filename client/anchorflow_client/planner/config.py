"""What may be set of a `Planner`."""

from __future__ import annotations

from dataclasses import dataclass

from anchorflow_client.contract.ranges import DEFAULT_TAU


@dataclass(frozen=True, kw_only=True)
class PlannerConfig:
    """How often is asked, how old a plan may grow, and what is added to what the loop sees."""

    max_age_ms: float = 1000.0
    """From when a plan is expired and a request is given up; also each request's budget_ms."""
    period_ms: float = 100.0
    """Least time between two requests."""
    first_retry_ms: float = 100.0
    """Wait after a failure; it doubles from one failure to the next."""
    longest_retry_ms: float = 500.0
    margin_m: float = 0.0
    """Beyond the robot's radius, that what follows the anchors asks for. It is sent as
    `refine.certified_margin`, so that an anchor is safe where the robot may drive along it."""
    switch_gain: float = 0.15
    """Share of its cost by which another route has to be better than the one in use."""
    stuck_s: float = 5.0
    """From when a robot with a plan that stays within `stuck_m` m of a place is stuck."""
    stuck_m: float = 0.5
    goal_clearance_m: float = 0.35
    """Of the local goal, from obstacles and from the map's edge; at least the robot's radius and
    the margin, where a request says the radius."""
    through_speed: float = 1.0
    """m/s at a local goal that stands in for one beyond the map."""
    warm_tau: float = DEFAULT_TAU
    """Flow time at which a warm start enters, in (0, 1)."""
    cold_every: int = 3
    """Every so manieth request starts from noise, to find other ways; 1: all of them."""

    def __post_init__(self) -> None:
        """Raises `ValueError` where a setting is out of range."""
        positive = ("max_age_ms", "period_ms", "first_retry_ms", "longest_retry_ms", "stuck_s")
        for name in positive:
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name}: expected a number above 0, got {getattr(self, name)}")
        for name in ("goal_clearance_m", "through_speed", "margin_m", "switch_gain", "stuck_m"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name}: expected a number from 0, got {getattr(self, name)}")
        if not 0.0 < self.warm_tau < 1.0:
            raise ValueError(f"warm_tau: expected a number in (0, 1), got {self.warm_tau}")
        if self.cold_every < 1:
            raise ValueError(f"cold_every: expected at least 1, got {self.cold_every}")
