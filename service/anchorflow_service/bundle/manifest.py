"""The manifest: the description of a bundle in manifest.json.

The reader validates it and the exporter writes it with the same classes. A planner is made of parts
by kind: conditioning (what a request brings), sampler (how anchors are drawn), finish (what is done
to them before they are answered). A part is the model card's class, or a subclass with
further fields that only a bundle holds.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import KW_ONLY, asdict, dataclass, field, fields, replace
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    model_validator,
)

from anchorflow_client.contract import (
    AnchorBatch,
    AnswerSpec,
    CostMapSpec,
    GuardSpec,
    ModelCard,
    NoFinish,
    OdeSpec,
    RefineSpec,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    TruncatedDiffusionSpec,
    VisionLanguageSpec,
    VocabularySpec,
)
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.contract.card import CONDITIONINGS, FINISHES, SAMPLERS, part_of
from anchorflow_client.contract.fields import LIMITS
from anchorflow_client.oip_codec import RESERVED
from anchorflow_trajectory.finish.refiner import DESCENT_RATE
from anchorflow_trajectory.ode.ddim import NoiseLevels
from anchorflow_trajectory.ode.methods import method_named
from anchorflow_trajectory.ode.schedule import check_schedule

FORMAT = 2
FILE_NAME = "manifest.json"
STATUS, VEHICLE_SIZE = "ego_status", "vehicle_size"
RAW_POSITIONS = "raw_positions"
"""An extra of every spline finish: the positions as they were sampled, before it."""
FIELDS_OF_ANSWER = {item.name for item in fields(AnchorBatch)}

# One path segment: a bundle never reads beside its own folder.
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


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


class Entry(BaseModel):
    """A frozen object of the manifest; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FileEntry(Entry):
    """A file beside the graphs, such as a vocabulary or a tokenizer."""

    file: FileName
    """Name in the bundle's own folder."""
    sha256: Sha256
    """Hash of the file's bytes, in hexadecimal digits."""


class GraphEntry(FileEntry):
    """One ONNX graph of the bundle; the key it stands under is its role."""

    opset: PositiveInt
    """ONNX opset."""
    precision: Literal["float32", "int8"] = "float32"
    """Precision of the products."""
    inputs: tuple[TensorSpec, ...]
    """Inputs in the graph's order, found by name among a request's inputs and other graphs'
    outputs."""
    outputs: tuple[TensorSpec, ...]

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(spec.name for spec in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(spec.name for spec in self.outputs)


class RequestEntry(Entry):
    """The inputs of a request."""

    inputs: Annotated[tuple[TensorSpec, ...], Field(min_length=1)]
    """Inputs by name; the first axis of each is B."""


class Manifest(Entry):
    """manifest.json; the axes of its tensors are letters, or numbers if the graph fixes them."""

    format: Literal[2]
    name: Annotated[str, Field(min_length=1)]
    """The name that a request's `model` gives."""
    version: Annotated[str, Field(min_length=1)]
    planner: str
    """A planner of `anchorflow train --planner`, or your own; the service does not read it."""
    request: RequestEntry
    conditioning: Annotated[
        CostMapSpec | TensorsSpec | VisionLanguageEntry, Field(discriminator="kind")
    ]
    sampler: Annotated[
        OdeEntry | VocabularySpec | TruncatedDiffusionEntry, Field(discriminator="kind")
    ]
    finish: Annotated[SplineEntry | GuardEntry | NoFinish, Field(discriminator="kind")]
    time: TimeSpec
    answer: AnswerSpec
    graphs: dict[str, GraphEntry]
    """Graphs by role; the kind of sampler says which roles it needs."""
    files: dict[str, FileEntry] = Field(default_factory=dict)
    """Files by role; others in the folder are not read."""
    training: dict[str, Any] = Field(default_factory=dict)
    """Provenance of the weights, for the card."""
    quality: dict[str, Any] = Field(default_factory=dict)
    """Results of a benchmark, for the card."""

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Manifest:
        for fault in (*self._time_faults(), *self._input_faults(), *self._answer_faults()):
            raise ValueError(fault)
        return self

    def _time_faults(self) -> Iterator[str]:
        """A planner with a cost map answers from now to the horizon, or each anchor to its end."""
        if not isinstance(self.conditioning, CostMapSpec):
            if self.time.dt is None:
                yield "time.dt is null, expected s between two poses of a planner without limits"
            return
        yield from _range_faults(self.conditioning)
        horizon_s = self.conditioning.limits.horizon_s
        dt = None if horizon_s is None else horizon_s / (self.time.steps - 1)
        if self.time.dt is None or dt is None:
            if self.time.dt is not dt:
                came = "null" if self.time.dt is None else self.time.dt
                want = "null beside limits.horizon_s null" if dt is None else f"{dt} s"
                yield f"time.dt is {came}, expected {want}"
        elif not math.isclose(self.time.dt, dt, rel_tol=1e-6):
            yield f"time.dt is {self.time.dt}, expected horizon_s / (steps - 1) = {dt}"
        if self.time.first_s != 0.0:
            yield f"time.first_s is {self.time.first_s}, expected 0 beside a cost map"

    def _input_faults(self) -> Iterator[str]:
        for spec in self.request.inputs:
            if spec.shape[:1] != ("B",):
                yield f"request.inputs: {spec.name} has shape {[*spec.shape]}, expected B first"
            if "." in spec.name:
                path = "which the binary form takes for a path"
                yield f"request.inputs: {spec.name} has a dot, {path}"
            if spec.name in RESERVED and not isinstance(self.conditioning, CostMapSpec):
                yield f"request.inputs: {spec.name} is a name that requests with a cost map have"

    def _answer_faults(self) -> Iterator[str]:
        for name in self.answer.arrays:
            if name not in ARRAY_DTYPES or name == "trajectories":
                known = ", ".join(list(ARRAY_DTYPES)[1:])
                yield f"answer.arrays: {name!r} is none of {known}"
        for spec in self.answer.extras:
            if spec.name in FIELDS_OF_ANSWER:
                yield f"answer.extras: {spec.name!r} is a name that every answer has"
        if isinstance(self.finish, GuardEntry):
            yield from self._guard_faults(self.finish)

    def _guard_faults(self, guard: GuardEntry) -> Iterator[str]:
        encode = self.graphs.get("encode")
        outputs = encode.output_names if encode else guard.tensors  # an exporter traces it later
        for name in guard.tensors:
            if name not in outputs:
                yield f"finish: {name!r} is not an output of encode: {', '.join(outputs)}"
        for name in guard.inputs:
            if name not in {spec.name for spec in self.request.inputs}:
                yield f"finish: {name!r} is not an input of the request"
        lasts_s = self.time.first_s + (self.time.steps - 1) * (self.time.dt or 0.0)
        if guard.horizon_s > lasts_s + 1e-9:
            yield f"finish.horizon_s is {guard.horizon_s:g}, expected at most the last pose's time"
        if not (guard.occupied or guard.agents):
            yield "finish: expected occupied, agents or both, got none"
        if self.answer.components != ("x", "y", "heading"):
            yield "finish: expected the components x, y and heading of a car's anchors"

    @property
    def D(self) -> int:
        """Components of a position."""
        return len(self.answer.components)

    def card(self, *, sha256: str) -> ModelCard:
        """Return the model card, which leaves out what only the bundle needs.

        sha256: hash of the manifest's bytes
        """
        return ModelCard(
            name=self.name,
            version=self.version,
            sha256=sha256,
            planner=self.planner,
            inputs=self.request.inputs,
            conditioning=part_of(asdict(self.conditioning), CONDITIONINGS),
            sampler=part_of(asdict(self.sampler), SAMPLERS),
            finish=part_of(asdict(self.finish), FINISHES),
            time=self.time,
            answer=self._answer(),
            quality=self.quality,
            training=self.training,
        )

    def _answer(self) -> AnswerSpec:
        """Return the answer with what a spline finish adds to the graphs' extras."""
        if self.finish.kind != "spline":
            return self.answer
        raw = TensorSpec(RAW_POSITIONS, "float32", ("B", "N", self.time.steps, self.D), "m")
        return replace(self.answer, extras=(*self.answer.extras, raw))

    def to_json(self) -> bytes:
        """Return the bytes of manifest.json."""
        return self.model_dump_json(indent=2).encode() + b"\n"


def parse_manifest(data: bytes) -> Manifest:
    """Validate the bytes of manifest.json. Raises ValueError, which names every wrong field."""
    _check_format(data)
    try:
        return Manifest.model_validate_json(data, strict=True)
    except ValidationError as error:
        wrong = "; ".join(_describe(item) for item in error.errors())
        raise ValueError(wrong) from error


def _check_format(data: bytes) -> None:
    """Report another format as one fault instead of twenty wrong fields."""
    try:
        found = json.loads(data).get("format")
    except (ValueError, AttributeError, RecursionError):
        return  # the validation of the manifest says what is wrong
    if isinstance(found, int) and found != FORMAT:
        again = "export its checkpoint anew with `anchorflow export CHECKPOINT --out FOLDER`"
        raise ValueError(f"format: expected {FORMAT}, got {found}: {again}")


def _describe(item: Any) -> str:
    path = ".".join(str(part) for part in item["loc"])
    # A dataclass reports an unknown key as Python would; a reader of JSON expects one message.
    is_extra = item["type"] == "unexpected_keyword_argument"
    message = "Extra inputs are not permitted" if is_extra else item["msg"]
    return f"{path}: {message}" if path else message


def _range_faults(spec: CostMapSpec) -> Iterator[str]:
    """Find ranges that no request could use, or that exclude the bundle's own limit."""
    for name, (low, high) in spec.ranges.items():
        where, wide = f"conditioning.ranges.{name}", LIMITS[name]
        own = getattr(spec.limits, name)
        if not wide.low <= low <= high <= wide.high:
            yield f"{where} is [{low:g}, {high:g}], expected least and greatest {wide}"
        elif own is not None and not low <= own <= high:
            yield f"{where} is [{low:g}, {high:g}], without limits.{name} = {own:g}"
    if spec.limits.horizon_s is None and "horizon_s" not in spec.ranges:
        yield (
            "conditioning.ranges.horizon_s is missing, expected least and greatest duration "
            "of an anchor beside limits.horizon_s null"
        )
