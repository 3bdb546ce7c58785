"""The configuration of DiffusionDriveV2."""

from __future__ import annotations

from dataclasses import dataclass, field

from anchorflow_models.checks import check
from anchorflow_models.transfuser import Places, TransfuserConfig, foretold_times
from anchorflow_trajectory.ode.ddim import NoiseLevels

POSES = 8
FIRST_S = STEP_S = 0.5  # s

FORETOLD_TIMES = foretold_times(POSES, STEP_S)
"""s, for which is foretold where others will be."""

SCHEDULES = {1: (8,), 2: (10, 0), 4: (15, 10, 5, 0)}
"""Noise levels of the steps, by their number."""
TRAINED_LEVELS = 50
"""Levels from 0 up to this one are drawn in training."""


@dataclass(frozen=True)
class DiffusionDriveConfig:
    """Everything that fixes the network's shapes and units; the defaults are the published ones.

    classes: of the semantic BEV
    width, heads, hidden: of the queries and of the denoiser
    query_layers: of the decoder that finds the ego's query and the agents'
    anchors: trajectories that the diffusion begins near
    denoiser_layers: each refines the poses of the one before
    scorer_width, scorer_heads, scorer_hidden: of both scorers
    fine_layers: of the fine scorer, each with heads of its own
    value_kernel: cells a side that a value looked up in the BEV has seen
    look_heads: shares of a value, each with weights of its own over a trajectory's points
    ego_motion: whether the ego's query and both scorers read the ego's speed and acceleration, and
        the scorers how each candidate continues them
    footprint: m ahead and to the left of a pose, places at which both scorers look up the BEV in
        all poses of a candidate; published is none
    encounters: m ahead and to the left of a pose, places at which both scorers look up who will be
        there when it is reached and within a second of it, if all go on as two sweeps of the LiDAR
        show, and as the front camera does beyond them; published is none
    ground_sight: whether the cameras' picture is also looked up on the ground, and denoiser and
        scorers look at a square as large as the LiDAR's that lies three eighths of its side farther
        ahead; published is not
    driven: whether the fine scorer's footprint and encounters look where a car drives that follows
        a candidate (`anchorflow_models.lqr_rollout`), in place of its own poses; published is not
    direction: whether both scorers also foretell how far a candidate drives against its lanes'
        direction (DDC), and multiply by it; published is not
    imitation: exponent of how likely a person would drive a candidate, in both scorers' scores;
        published is 0, no head that foretells it
    pessimistic: whether a candidate is worth the least that the coarse scorer and any layer of the
        fine one foretell; published: what the last layer foretells
    x_range, y_range: m, what the diffusion's unit interval spans; a place beyond is drawn to it
    diversity: spread of the factors on x and on y that make variants of a denoised trajectory
    bezier_degree: of the curve that each variant is fitted to
    vocabulary: fixed trajectories that are scored beside those denoised
    groups, variants: how often each anchor begins, and each denoised trajectory is varied
    keep: the best by coarse scores that are scored finely
    noise: variances (beta) of the first and the last of the diffusion's 1000 levels
    start: the level at which the diffusion is cut off: anchors begin with its noise
    steps: of denoising, of those that SCHEDULES has

    Raises:
        ValueError: a field is out of its range; the message names it, what was expected and got.
    """

    backbone: TransfuserConfig = field(default_factory=TransfuserConfig)
    classes: int = 7
    width: int = 256
    heads: int = 8
    hidden: int = 1024
    query_layers: int = 3
    anchors: int = 20
    denoiser_layers: int = 2
    scorer_width: int = 512
    scorer_heads: int = 16
    scorer_hidden: int = 2048
    fine_layers: int = 3
    value_kernel: int = 3
    look_heads: int = 1
    ego_motion: bool = False
    footprint: Places = ()
    encounters: Places = ()
    ground_sight: bool = False
    driven: bool = field(default=False, metadata={"free": True})
    direction: bool = False
    imitation: float = 0.0
    pessimistic: bool = field(default=False, metadata={"free": True})
    x_range: tuple[float, float] = (-1.2, 55.7)
    y_range: tuple[float, float] = (-20.0, 26.0)
    diversity: tuple[float, float] = (0.1, 0.1)
    bezier_degree: int = 5
    vocabulary: int = 0
    groups: int = 10
    variants: int = 4
    keep: int = 32
    noise: tuple[float, float] = field(default=(1e-4, 0.02), metadata={"free": True})
    start: int = field(default=8, metadata={"free": True})
    steps: int = 2

    def __post_init__(self) -> None:
        for name in (
            *("classes", "anchors", "heads", "scorer_heads", "hidden", "scorer_hidden"),
            *("query_layers", "denoiser_layers", "fine_layers", "groups", "variants", "keep"),
            "look_heads",
        ):
            check(name, getattr(self, name) >= 1, "at least 1", getattr(self, name))
        for name, heads in (
            *(("width", self.heads), ("scorer_width", self.scorer_heads)),
            *(("width", self.look_heads), ("scorer_width", self.look_heads)),
        ):
            width = getattr(self, name)
            fits = width > 0 and width % heads == 0 and width % 2 == 0
            check(name, fits, f"an even multiple of its {heads} heads", width)
        for name in ("x_range", "y_range"):
            low, high = getattr(self, name)
            check(name, low < 0.0 < high, "least below 0, greatest above", (low, high))
        check("value_kernel", self.value_kernel in (1, 3, 5), "1, 3 or 5", self.value_kernel)
        seen = self.backbone.lidar_before or not self.encounters
        check("encounters", seen, "none without lidar_before of the backbone", self.encounters)
        check("driven", self.ego_motion or not self.driven, "false without ego_motion", True)
        looks = bool(self.footprint or self.encounters)
        check("driven", looks or not self.driven, "false without footprint or encounters", True)
        check("imitation", self.imitation >= 0, "at least 0", self.imitation)
        check("diversity", min(self.diversity) >= 0, "at least 0 each", self.diversity)
        fits = 1 <= self.bezier_degree <= POSES
        check("bezier_degree", fits, f"1 to {POSES}", self.bezier_degree)
        check("start", 0 <= self.start < 1000, "a level from 0 to 999", self.start)
        check("noise", 0 < self.noise[0] <= self.noise[1] < 1, "0 < first <= last < 1", self.noise)
        check("steps", self.steps in SCHEDULES, f"one of {[*SCHEDULES]}", self.steps)
        check("keep", self.keep <= self.candidates, f"at most {self.candidates}", self.keep)
        check("vocabulary", self.vocabulary >= 0, "at least 0", self.vocabulary)

    @property
    def noise_levels(self) -> NoiseLevels:
        """How much of the data is left at each level."""
        return NoiseLevels(first=self.noise[0], last=self.noise[1])

    @property
    def bev_ahead(self) -> float:
        """Offset in m of the BEV of denoiser and scorers ahead of the LiDAR's square."""
        return self.backbone.ground_ahead if self.ground_sight else 0.0

    @property
    def candidates(self) -> int:
        """All that the coarse scorer judges."""
        return self.anchors * self.groups * self.variants + self.vocabulary
