"""The configuration of GoalFlow."""

from __future__ import annotations

from dataclasses import dataclass, field

from anchorflow_models.checks import check
from anchorflow_models.layers.blocks import GROUPS
from anchorflow_models.transfuser import GROUND_WIDTH, TransfuserConfig

BACKBONES = ("mlp", "transformer")
RASTERS = ("uint8", "float32")
STRIDES = 16
"""Cells of the raster a side of the coarsest cell of the features."""
STRIDE, SENSED_STRIDE = 4, 2
"""Cells a side of a cell of the features: of the raster, and of what sensors show, whose cells are
twice as large."""
HALTINGS = (1.5, 3.0, 5.0)
"""m/s² by which the halts brake: ways to no goal, which are driven without a change."""
TURNS = ((0.1, 5.0), (0.2, 5.0), (0.2, 2.5))
"""Greatest curvature in 1/m, to either side, and final speed in m/s of the turns; like halts, they
are driven without a change."""
PACES = (2.5, 5.0, 7.5, 10.0, 12.5, 15.0)
"""Final speeds in m/s of ways along a route; further ways halt on it by HALTINGS."""
ASIDE = (0.0, 1.0, -1.0)
"""m to the left of the route that ways along it keep; first the route itself."""
LEAST = {
    "goals": 8,
    "picked": 1,
    "num_steps": 2,
    "feature_channels": 1,
    "width": 16,
    "layers": 1,
    "channels": 8,
    "heads": 1,
    "context": 1,
    "scorer_width": 1,
    "outcome_width": 1,
}


@dataclass(frozen=True)
class BevLayout:
    """The raster that the network looks at: drawn by `anchorflow_driving.sensors.bev`, or features.

    channels: C; extent: least and greatest x, least and greatest y, m
    dtype: "uint8" if it is drawn, "float32" if it is features; they have no channels by name, so
        that the score knows of no road and of nobody
    drivable: the channel of the drivable area
    boxes: the first of three of who is where now: vehicles, people, static objects
    occupied: the first of those that foretell it, `foretold` of them, the first dt from now
    """

    channels: int = 20
    rows: int = 192
    columns: int = 128
    extent: tuple[float, float, float, float] = (-16.0, 80.0, -32.0, 32.0)
    dtype: str = "uint8"
    drivable: int = 0
    boxes: int = 7
    occupied: int = 11
    foretold: int = 9

    @property
    def padding(self) -> tuple[int, int]:
        """Rows and columns that are added at the end, for a multiple of STRIDES."""
        return -self.rows % STRIDES, -self.columns % STRIDES

    @property
    def covered(self) -> tuple[float, float, float, float]:
        """The extent with the rows and columns that are added."""
        low_x, high_x, low_y, high_y = self.extent
        below, right = self.padding
        low_x -= below * (high_x - low_x) / self.rows
        low_y -= right * (high_y - low_y) / self.columns
        return low_x, high_x, low_y, high_y


@dataclass(frozen=True)
class ScoreWeights:
    """Weights of a trajectory's score; see `trajectory_score`.

    route, goal, drivable: exponents of how likely it follows the route, ends near where was driven
        and stays on the road, as the network thinks
    reach: m, spread of the distance from its goal
    progress, time_to_collision, comfort: of the weighted mean; progress counts more than in the PDM
        score, for it is measured against a clear road, which few have
    clear_speed: m/s that a clear road is driven at
    """

    route: float = 0.5
    goal: float = 0.2
    drivable: float = 1.0
    reach: float = 4.0
    progress: float = 10.0
    time_to_collision: float = 5.0
    comfort: float = 2.0
    clear_speed: float = 15.0


@dataclass(frozen=True)
class GoalFlowConfig:
    """Everything that fixes the network's shape and its units.

    num_steps: T; dt: s between two poses, the first dt from now
    goals: K of the vocabulary; picked: how many of them trajectories are drawn to, beside a shadow,
        turns and halts
    spacing: m that picked goals keep from each other
    sigma: spread of the noise, in units of the distance of trajectories from the way to their goal
    outcomes: whether learnt outcomes count in the score of trajectories, beside the rules of
        `trajectory_score`
    backbone: "mlp" or "transformer", the network that is the vector field
    width, layers: of the backbone; heads: of the transformer
    channels: of the scene encoder's first level; context: numbers of a scene as a whole
    scorer_width, outcome_width: of the networks that score goals, and trajectories
    feature_channels: that poses look up at their places
    bev: the raster; with sensors the one that they are to show, and that training draws
    sensors: whether a Transfuser backbone looks at cameras and LiDAR in place of the raster
    transfuser: this backbone, of sensors; ground_sight: as of WoTE, with sensors

    Raises:
        ValueError: a field is out of its range; the message names it, what was expected and got.
    """

    num_steps: int = 8
    dt: float = 0.5
    goals: int = 256
    picked: int = 31
    spacing: float = 2.0
    sigma: float = 0.1
    outcomes: bool = field(default=False, metadata={"may_come_later": True})
    backbone: str = "mlp"
    width: int = 192
    layers: int = 2
    heads: int = 4
    channels: int = 24
    context: int = 96
    scorer_width: int = 96
    outcome_width: int = 192
    feature_channels: int = 24
    bev: BevLayout = field(default_factory=BevLayout)
    score: ScoreWeights = field(default_factory=ScoreWeights, metadata={"free": True})
    sensors: bool = False
    ground_sight: bool = False
    transfuser: TransfuserConfig = field(default_factory=TransfuserConfig)

    def __post_init__(self) -> None:
        known = f"one of {', '.join(BACKBONES)}"
        check("backbone", self.backbone in BACKBONES, known, repr(self.backbone))
        kinds = f"one of {', '.join(RASTERS)}"
        check("bev.dtype", self.bev.dtype in RASTERS, kinds, repr(self.bev.dtype))
        own = vars(self)
        even = self.width % 2 == 0 and self.width % max(self.heads, 1) == 0
        sides = {f"bev.{name}": getattr(self.bev, name) for name in ("rows", "columns")}
        for name, got, fits, what in (
            *((n, own[n], own[n] >= least, f"at least {least}") for n, least in LEAST.items()),
            ("channels", self.channels, self.channels % GROUPS == 0, f"a multiple of {GROUPS}"),
            ("width", self.width, even, f"an even multiple of heads, {self.heads}"),
            ("picked", self.picked, self.picked < self.goals, f"below goals, {self.goals}"),
            *((n, own[n], own[n] > 0, "above 0") for n in ("dt", "sigma")),
            *((f"score.{n}", w, w >= 0, "at least 0") for n, w in vars(self.score).items()),
            ("score.reach", self.score.reach, self.score.reach > 0, "above 0"),
            *((n, side, side >= 1, "at least 1") for n, side in sides.items()),
        ):
            check(name, fits, what, got)
        self._check_sensors()

    def _check_sensors(self) -> None:
        alone = self.sensors or not self.ground_sight
        check("ground_sight", alone, "false without sensors", self.ground_sight)
        if self.sensors:
            drawn = self.bev.dtype == "uint8" and self.bev.padding == (0, 0)
            whole = f"uint8 of sides that are multiples of {STRIDES}, with sensors"
            check("bev", drawn, whole, (self.bev.dtype, self.bev.rows, self.bev.columns))

    @property
    def seen(self) -> tuple[int, int, int]:
        """Channels, rows and columns of what the scene's encoder takes."""
        if not self.sensors:
            return self.bev.channels, self.bev.rows, self.bev.columns
        channels = self.transfuser.bev_channels + GROUND_WIDTH * self.ground_sight
        cell = STRIDE // SENSED_STRIDE
        return channels, self.bev.rows // cell, self.bev.columns // cell

    @property
    def ways(self) -> int:
        """Ways that trajectories begin on: to each picked goal, the shadow, the turns, the halts,
        and those along a route."""
        return self.picked + 1 + 2 * len(TURNS) + len(HALTINGS) + self.along

    @property
    def along(self) -> int:
        """Number of ways along a given route; without one, the other ways are repeated."""
        return len(HALTINGS) + len(PACES) * len(ASIDE)
