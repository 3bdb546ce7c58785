"""The parts of a planner as the manifest describes them, by kind.

Conditioning is what a request brings, the sampler is how anchors are drawn, and the finish is what
is done to them before they are answered. A part is the model card's class, or a subclass with
further fields that only a bundle holds.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import Annotated

from pydantic import (
    AfterValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
)

from anchorflow_client.contract import (
    GuardSpec,
    OdeSpec,
    RefineSpec,
    TruncatedDiffusionSpec,
    VisionLanguageSpec,
)
from anchorflow_trajectory.finish.refiner import DESCENT_RATE
from anchorflow_trajectory.ode.ddim import NoiseLevels
from anchorflow_trajectory.ode.methods import method_named
from anchorflow_trajectory.ode.schedule import check_schedule

STATUS, VEHICLE_SIZE = "ego_status", "vehicle_size"


@dataclass(frozen=True)
class VisionLanguageEntry(VisionLanguageSpec):
    """Conditioning on pictures and a text, with the inputs that hold them."""

    _: KW_ONLY
    images: Annotated[tuple[str, ...], Field(min_length=1)]
    """The request's inputs that are pictures. The service remembers the features of the optional
    ones by their content."""
    text: str
    """The request's input that is a text, tokenized by the bundle's file `tokenizer`."""


@dataclass(frozen=True)
class PriorEntry:
    """The prior of a flow, which turns noise [N,R] into x_0 = mean + noise · basis."""

    mean: str
    """Name of [B,T,S] that encode gives; or of [B,M,T,S] that encode or the scene gives, the M
    components of a mixture over which the anchors are dealt out in turn."""
    basis: str
    """Name of [B,R,T*S] that encode gives."""


@dataclass(frozen=True)
class OdeEntry(OdeSpec):
    """A flow that carries noise to anchors by an explicit method; defaults of the card."""

    method: Annotated[str, AfterValidator(lambda name: method_named(name).name)] = field()
    """`euler`, `midpoint`, `rk4`, …."""
    schedule: Annotated[tuple[float, ...], AfterValidator(check_schedule)] = field()
    """Flow times, rising from 0 to 1."""
    prior: PriorEntry | None = None
    """Null if a flow begins with the noise itself, [N,T,S]."""


@dataclass(frozen=True)
class TruncatedDiffusionEntry(TruncatedDiffusionSpec):
    """A diffusion that begins at anchors with a little noise; then the best, coarse to fine."""

    size: int = field(init=False)
    candidates: int = field(init=False)
    choices: tuple[int, ...] = field(init=False)
    _: KW_ONLY
    anchors: PositiveInt
    """Trajectories that the graphs start from."""
    groups: PositiveInt
    """Noises that each anchor begins with."""
    variants: PositiveInt
    """Variants of each denoised trajectory, the first without noise of its own."""
    vocabulary: NonNegativeInt = 0
    """Trajectories that the coarse graph adds to the candidates."""
    keep: PositiveInt
    """The best by coarse scores, which are scored finely."""
    noise: NoiseLevels
    start: NonNegativeInt
    """The level at which anchors begin."""
    schedules: Annotated[tuple[tuple[int, ...], ...], Field(min_length=1)]
    """The levels at which each number of steps denoises."""
    steps: PositiveInt
    """Default number of steps."""

    def __post_init__(self) -> None:
        scored = self.anchors * self.groups * self.variants + self.vocabulary
        derived = {
            "size": self.keep,
            "candidates": scored,
            "choices": tuple(len(schedule) for schedule in self.schedules),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)
        try:
            for schedule in self.schedules:
                self.noise.check_times(schedule)
        except ValueError as error:
            raise ValueError(f"schedules: {error}") from error
        if self.start >= self.noise.levels:
            raise ValueError(f"start: expected a level below {self.noise.levels}, got {self.start}")
        if self.steps not in self.choices or len(set(self.choices)) < len(self.choices):
            known = ", ".join(map(str, self.choices))
            raise ValueError(f"steps: expected one of {known}, each once, got {self.steps}")
        if self.keep > self.candidates:
            raise ValueError(f"keep: expected at most {self.candidates}, got {self.keep}")

    def levels_of(self, steps: int) -> tuple[int, ...]:
        """Return the levels at which this number of steps denoises."""
        return self.schedules[self.choices.index(steps)]


@dataclass(frozen=True)
class SplineEntry(RefineSpec):
    """Splines that meet both ends: the card's defaults of a request's `refine`, and the spline."""

    safety_margin: NonNegativeFloat = field()
    guidance: NonNegativeFloat = field()
    certified_margin: NonNegativeFloat = 0.0
    _: KW_ONLY
    steps: PositiveInt
    """Descent steps of the projection."""
    rate: PositiveFloat = DESCENT_RATE
    """Step size in m of the first descent step."""
    num_control_points: PositiveInt
    degree: PositiveInt


@dataclass(frozen=True)
class RasterEntry:
    """A raster seen from above that encode gives, as a TensorSpec with an extent describes it."""

    tensor: str
    """[B,C,H,W] or [B,H,W,1]."""
    extent: tuple[float, float, float, float]
    """Least and greatest x, least and greatest y in m."""
    _: KW_ONLY
    first_s: NonNegativeFloat = 0.0
    step_s: PositiveFloat = 1.0
    """Seconds from now to the first channel, and from one to the next, if they are times."""
    complement_of: NonNegativeInt | None = None
    """The channel that says what the raster is not; null if the first says what it is."""


@dataclass(frozen=True)
class AgentsEntry:
    """Boxes that encode gives."""

    boxes: str
    """[B,K,5] x, y, heading, length, width."""
    scores: str
    """[B,K]."""
    least: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    """Score from which on a box counts."""


@dataclass(frozen=True)
class GuardEntry(GuardSpec):
    """The guard of a car, and where it finds what the planner perceives.

    Requests have the input `ego_status`, whose numbers 4 and 5 are the velocity x, y in m/s.
    """

    _: KW_ONLY
    size: tuple[PositiveFloat, PositiveFloat] | None
    """Length and width of the car in m; null if requests have the input `vehicle_size`."""
    road: RasterEntry
    """Where one may drive."""
    occupied: RasterEntry | None = None
    """What others take, by time. Without `agents` these are boxes at constant velocity from now."""
    agents: AgentsEntry | None = None

    @property
    def tensors(self) -> tuple[str, ...]:
        """Outputs of encode that the guard reads."""
        rasters = [each.tensor for each in (self.road, self.occupied) if each]
        agents = (self.agents.boxes, self.agents.scores) if self.agents else ()
        return (*rasters, *agents)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Inputs of a request that the guard reads."""
        return (STATUS, *(() if self.size else (VEHICLE_SIZE,)))
