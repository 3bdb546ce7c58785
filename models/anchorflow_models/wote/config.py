"""The configuration of WoTE."""

from __future__ import annotations

from dataclasses import dataclass, field

from anchorflow_models.checks import check
from anchorflow_models.transfuser import (
    AGENT_QUERIES,
    FORETOLD_S,
    Places,
    TransfuserConfig,
    foretold_times,
)

LEAST = {
    "anchors": 1,
    "num_steps": 2,
    "width": 1,
    "heads": 1,
    "hidden": 1,
    "anchor_layers": 0,
    "offset_layers": 0,
    "world_layers": 0,
    "future_steps": 1,
    "agents": 1,
    "agent_layers": 1,
    "semantic_classes": 2,
}


@dataclass(frozen=True)
class RewardWeights:
    """What each reward counts in the final score; the defaults are the published ones.

    score = im log(im) + nc log(NC) + dac log(DAC) + rest log(ttc TTC + c C + ep EP)
    """

    im: float = 0.1
    nc: float = 0.5
    dac: float = 0.5
    rest: float = 1.0
    ttc: float = 5.0
    c: float = 2.0
    ep: float = 5.0

    def __post_init__(self) -> None:
        for name, weight in vars(self).items():
            check(name, weight >= 0, "at least 0", weight)


@dataclass(frozen=True)
class WoteConfig:
    """Everything that fixes the network's shape and units; the defaults are the published ones.

    anchors: K; kept: of them, by their offset scores, that the world model looks at; 0: all
    num_steps: T poses; dt: s between two, the first dt from now
    width, heads, hidden: of all transformers behind the backbone; hidden: of their feed-forwards
    anchor_layers: of the encoder in which anchors attend to each other
    offsets: whether anchors are moved before they are answered; offset_layers: of what moves them
    world_layers: of the world model, one step of it; 0: the future BEV is the present one
    future_steps: steps of the world model over the horizon
    shared_future: whether imagined BEVs have the places of the present one and are read by its
        semantic head, as the published code does; otherwise they have their own
    rewards_of_all_steps: whether rewards look at every step of the world model, not only the last
    agents, agent_layers: boxes that are detected, layers of their decoder
    semantic_classes: of the semantic BEV
    rewards: what each counts
    footprint: m ahead and to the left of a pose, places at which the rewards look up the fine BEV
        in all poses of an anchor; published is none
    encounters: likewise, places at which the rewards look up who will be there when the pose is
        reached and within a second of it, if all go on as two sweeps of the LiDAR show, and as the
        front camera does beyond them; published is none
    ground_sight: whether the cameras' picture is also looked up on the ground, and all that look at
        the BEV look at a square as large as the LiDAR's that lies three eighths of its side farther
        ahead; published is not
    driven: whether footprint and encounters look where a car drives that follows an anchor
        (`anchorflow_models.lqr_rollout`), in place of the anchor's own poses; published is not

    Raises:
        ValueError: a field is out of its range; the message names it, what was expected and got.
    """

    anchors: int = 256
    kept: int = 0
    num_steps: int = 8
    dt: float = 0.5
    width: int = 256
    heads: int = 8
    hidden: int = 1024
    anchor_layers: int = 2
    offsets: bool = True
    offset_layers: int = 3
    world_layers: int = 2
    future_steps: int = 1
    shared_future: bool = False
    rewards_of_all_steps: bool = False
    agents: int = AGENT_QUERIES
    agent_layers: int = 3
    semantic_classes: int = 8
    rewards: RewardWeights = field(default_factory=RewardWeights, metadata={"free": True})
    footprint: Places = ()
    encounters: Places = ()
    ground_sight: bool = False
    driven: bool = field(default=False, metadata={"free": True})
    backbone: TransfuserConfig = field(default_factory=TransfuserConfig)

    def __post_init__(self) -> None:
        for name, least in LEAST.items():
            value = getattr(self, name)
            check(name, value >= least, f"at least {least}", value)
        check("dt", self.dt > 0, "more than 0", self.dt)
        fits = self.width % self.heads == 0
        check("width", fits, f"a multiple of heads, {self.heads}", self.width)
        check("kept", 0 <= self.kept <= self.anchors, f"from 0 to {self.anchors}", self.kept)
        ranked = self.offsets or self.kept in (0, self.anchors)
        check("kept", ranked, "0 without offsets, whose scores choose", self.kept)
        if self.encounters:
            seen = self.backbone.lidar_before
            check("encounters", seen, "none without lidar_before of the backbone", self.encounters)
            apart = self.dt / FORETOLD_S
            check("dt", apart == int(apart), f"a multiple of {FORETOLD_S} for encounters", self.dt)
        looks = bool(self.footprint or self.encounters)
        check("driven", looks or not self.driven, "false without footprint or encounters", True)
        if self.ground_sight:
            own = not self.shared_future
            check("shared_future", own, "false with ground_sight, whose BEVs differ", True)
            check("ground_sight", bool(self.footprint), "false without a footprint", True)
            size = self.backbone.bev_size
            check("backbone", size % 8 == 0, "a BEV of 8 n cells a side for ground_sight", size)

    @property
    def judged(self) -> int:
        """Anchors that the world model looks at, and that are answered."""
        return self.kept or self.anchors

    @property
    def bev_ahead(self) -> float:
        """Offset in m of the BEV that anchors are judged on from the LiDAR's square, ahead."""
        return self.backbone.ground_ahead if self.ground_sight else 0.0

    @property
    def bev_rows(self) -> int:
        """The same in rows of its tokens."""
        return 3 * self.backbone.bev_size // 8 if self.ground_sight else 0

    @property
    def foretold_times(self) -> tuple[float, ...]:
        """s, for which is foretold where others will be, with `encounters`."""
        return foretold_times(self.num_steps, self.dt)
