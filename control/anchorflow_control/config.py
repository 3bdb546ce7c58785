"""The settings of an `MppiController`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from anchorflow_client.contract.checks import Interval, is_number
from anchorflow_client.contract.fields import DEFAULT_COST_PENALTY

AT_LEAST_0 = Interval(0.0, math.inf, open_high=True)
ABOVE_0 = Interval(0.0, math.inf, open_low=True, open_high=True)
SHARE = Interval(0.0, 1.0)
INTERVALS = {
    "motions": Interval(16, 65536),
    "steps": Interval(4, 400),
    "dt": Interval(0.0, 1.0, "s", open_low=True),
    "max_anchors": Interval(0, 256),
    "temperature": ABOVE_0,
    "noise": ABOVE_0,
    "margin": AT_LEAST_0,
    "comfort": ABOVE_0,
    "switch_cost": AT_LEAST_0,
    "off_route": AT_LEAST_0,
    "collision": AT_LEAST_0,
    "nearness": AT_LEAST_0,
    "distance": AT_LEAST_0,
    "arrival": AT_LEAST_0,
    "effort": AT_LEAST_0,
    "smoothness": AT_LEAST_0,
    "reversing": AT_LEAST_0,
    "terminal": AT_LEAST_0,
    "cost_penalty": AT_LEAST_0,
}
"""The range of each number of an `MppiConfig`."""
WHOLE = ("motions", "steps", "max_anchors")


@dataclass(frozen=True, kw_only=True)
class MppiConfig:
    """How many motions are rolled out, how they are drawn, and what they cost."""

    motions: int = 1024
    """Rolled out at each tick, those along anchors included."""
    steps: int = 40
    """Steps a motion has."""
    dt: float = 0.1
    """s, of a step; a tick may be shorter."""
    max_anchors: int = 16
    """Anchors that are followed at each tick: the best by score, those of other routes first."""
    temperature: float = 0.1
    """Lambda of MPPI, in units of cost."""
    noise: float = 0.4
    """Standard deviation of the disturbances, as a share of a_max and alpha_max."""
    margin: float = 0.03
    """m beyond the body; nearer to an obstacle is a collision."""
    comfort: float = 0.3
    """m beyond the margin; from there on nearness costs nothing."""
    switch_cost: float = 1.0
    """Cost by which another way round the obstacles has to be better than the one in progress."""
    off_route: float = 1.5
    """m added to the length of anchors off the route of a `Plan`."""
    collision: float = 100.0
    """Cost of a second in collision."""
    nearness: float = 2.0
    """Cost of a metre just beyond the margin; it falls as a square to 0 at `comfort`."""
    distance: float = 0.1
    """Cost of a second per m from the goal."""
    arrival: float = 1.0
    """The same within 1 m of the goal, in addition."""
    effort: float = 0.02
    """Cost of a second at full acceleration, and of one at the full turn rate."""
    smoothness: float = 0.02
    """Cost of a second in which the acceleration changes by its limit at each step."""
    reversing: float = 0.5
    """Cost of a metre backwards."""
    terminal: float = 3.0
    """Cost of a metre left at the end of the motion."""
    cost_penalty: float = DEFAULT_COST_PENALTY
    """m of detour that one metre through soft cost 1 is worth, as in a request."""

    def __post_init__(self) -> None:
        """Raise `ValueError` if a setting is out of range."""
        for name, interval in INTERVALS.items():
            value = getattr(self, name)
            whole = name not in WHOLE or isinstance(value, int)
            if not is_number(value) or not whole or not interval.holds(value):
                kind = "an integer" if name in WHOLE else "a number"
                raise ValueError(f"{name}: expected {kind} {interval}, got {value!r}")
