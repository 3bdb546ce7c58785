"""The configuration of the network that predicts the others."""

from __future__ import annotations

from dataclasses import dataclass, field

from anchorflow_models.checks import check
from anchorflow_models.goalflow.config import BevLayout

LEAST = {"modes": 1, "num_steps": 1, "width": 8, "map_channels": 4, "others": 1, "times": 2}


@dataclass(frozen=True)
class FuturesConfig:
    """The network's shape and units.

    modes: M of each road user
    num_steps: T; dt: s between two poses, the first dt from now
    others: A, the most road users of a request; times: H of each
    width: of the hidden layers; map_channels: of the first convolution over the lanes around
    """

    modes: int = 6
    num_steps: int = 8
    dt: float = 0.5
    others: int = 48
    times: int = 5
    width: int = 128
    map_channels: int = 12
    bev: BevLayout = field(default_factory=BevLayout)

    def __post_init__(self) -> None:
        own = vars(self)
        for name, least in LEAST.items():
            check(name, own[name] >= least, f"at least {least}", own[name])
        check("dt", self.dt > 0, "above 0", self.dt)
