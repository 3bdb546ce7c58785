"""The manifest: what a bundle says of itself in manifest.json.

The reader checks it and the exporter writes it with the same classes. A planner is put together of
parts by kind, each an entry of its own: how it is asked (conditioning), how anchors are drawn
(sampler), what is done to them before they are answered (finish).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    model_validator,
)

from anchorflow_client.contract import (
    AnswerSpec,
    CostMapSpec,
    LimitsSpec,
    ModelCard,
    NoFinish,
    OdeSpec,
    RefineSpec,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    VocabularySpec,
)
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.oip_codec import RESERVED
from anchorflow_trajectory.ode.method import method_named
from anchorflow_trajectory.ode.schedule import check_schedule

FORMAT = 2
FILE_NAME = "manifest.json"

Adjustable = Literal["robot_radius", "v_max", "a_max", "horizon_s"]
# One path segment: a bundle never reads beside its own folder.
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Entry(BaseModel):
    """A frozen piece of the manifest; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FileEntry(Entry):
    """A file beside the graphs, such as a vocabulary or a tokenizer."""

    file: FileName
    sha256: Sha256


class GraphEntry(FileEntry):
    """One ONNX graph of the bundle; the key it stands under is its role.

    precision: of its products
    """

    opset: PositiveInt
    precision: Literal["float32", "int8"] = "float32"
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(spec.name for spec in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(spec.name for spec in self.outputs)


class RequestEntry(Entry):
    """inputs: what a caller sends, by name; the first axis of each is B."""

    inputs: Annotated[tuple[TensorSpec, ...], Field(min_length=1)]


class LimitsEntry(Entry):
    """horizon_s [s], v_max [m/s], a_max [m/s²] and robot_radius [m] that the model was made for."""

    horizon_s: PositiveFloat
    v_max: PositiveFloat
    a_max: PositiveFloat
    robot_radius: NonNegativeFloat


class CostMapEntry(Entry):
    """Asked with a cost map, a state, a goal and a style.

    channels: of the map, at most; H, W: cells of the grid that the model was trained on
    adjustable: limits that a request may change
    """

    kind: Literal["cost_map"] = "cost_map"
    channels: PositiveInt
    H: PositiveInt
    W: PositiveInt
    limits: LimitsEntry
    adjustable: tuple[Adjustable, ...] = ()

    def spec(self) -> CostMapSpec:
        """What the card says of it."""
        limits = LimitsSpec(**self.limits.model_dump())
        return CostMapSpec(self.channels, self.H, self.W, limits, self.adjustable)


class TensorsEntry(Entry):
    """Asked with the inputs that the request lists, and nothing else."""

    kind: Literal["tensors"] = "tensors"

    def spec(self) -> TensorsSpec:
        """What the card says of it."""
        return TensorsSpec()


class PriorEntry(Entry):
    """The encode outputs that turn noise [N,R] into x_0 = mean + noise · basis.

    mean: name of [B,T,S]; basis: name of [B,R,T*S]
    """

    mean: str
    basis: str


class OdeEntry(Entry):
    """A flow, carried from noise by an explicit method; the card's defaults."""

    kind: Literal["ode"] = "ode"
    method: Annotated[str, AfterValidator(lambda name: method_named(name).name)]
    schedule: Annotated[tuple[float, ...], AfterValidator(check_schedule)]
    prior: PriorEntry | None = None

    def spec(self) -> OdeSpec:
        """What the card says of it."""
        return OdeSpec(self.method, self.schedule)


class VocabularyEntry(Entry):
    """The best N of `size` trajectories, which the graphs give and may have refined."""

    kind: Literal["vocabulary"] = "vocabulary"
    size: PositiveInt

    def spec(self) -> VocabularySpec:
        """What the card says of it."""
        return VocabularySpec(self.size)


class SplineEntry(Entry):
    """Splines that meet both ends: the card's defaults, and the spline they are finished on."""

    kind: Literal["spline"] = "spline"
    smooth: bool
    project: bool
    safety_margin: NonNegativeFloat
    guidance: NonNegativeFloat
    barrier: bool = False
    certified_margin: NonNegativeFloat = 0.0
    steps: PositiveInt
    num_control_points: PositiveInt
    degree: PositiveInt

    def spec(self) -> RefineSpec:
        """What the card says of it."""
        return RefineSpec(
            self.smooth,
            self.project,
            self.safety_margin,
            self.guidance,
            self.barrier,
            self.certified_margin,
        )


class NoFinishEntry(Entry):
    """Anchors are answered as they were sampled."""

    kind: Literal["none"] = "none"

    def spec(self) -> NoFinish:
        """What the card says of it."""
        return NoFinish()


class TimeEntry(Entry):
    """Poses at first_s + k dt [s], k from 0 to steps - 1."""

    steps: Annotated[int, Field(ge=2)]
    first_s: NonNegativeFloat
    dt: PositiveFloat


class AnswerEntry(Entry):
    """What an answer holds beside its trajectories [N,T,D].

    components: the names of D's parts; arrays: which of the contract's are always there
    extras: further outputs of the graphs, sent where a request asks for them
    """

    components: Annotated[tuple[str, ...], Field(min_length=2)]
    arrays: tuple[str, ...] = ()
    extras: tuple[TensorSpec, ...] = ()


class Manifest(Entry):
    """manifest.json; the axes of its tensors are letters, or numbers where the graph fixes them."""

    format: Literal[2]
    name: Annotated[str, Field(min_length=1)]
    version: Annotated[str, Field(min_length=1)]
    planner: str
    request: RequestEntry
    conditioning: Annotated[CostMapEntry | TensorsEntry, Field(discriminator="kind")]
    sampler: Annotated[OdeEntry | VocabularyEntry, Field(discriminator="kind")]
    finish: Annotated[SplineEntry | NoFinishEntry, Field(discriminator="kind")]
    time: TimeEntry
    answer: AnswerEntry
    graphs: dict[str, GraphEntry]
    files: dict[str, FileEntry] = {}
    training: dict[str, Any] = {}
    quality: dict[str, Any] = {}

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Manifest:
        for fault in (*self._time_faults(), *self._input_faults(), *self._answer_faults()):
            raise ValueError(fault)
        return self

    def _time_faults(self) -> Iterator[str]:
        """A planner with a cost map answers from now to the horizon."""
        if isinstance(self.conditioning, TensorsEntry):
            return
        dt = self.conditioning.limits.horizon_s / (self.time.steps - 1)
        if not math.isclose(self.time.dt, dt, rel_tol=1e-6):
            yield f"time.dt is {self.time.dt}, expected horizon_s / (steps - 1) = {dt}"
        if self.time.first_s != 0.0:
            yield f"time.first_s is {self.time.first_s}, expected 0 beside a cost map"

    def _input_faults(self) -> Iterator[str]:
        for spec in self.request.inputs:
            if spec.shape[:1] != ("B",):
                yield f"request.inputs: {spec.name} has shape {[*spec.shape]}, expected B first"
            if spec.name in RESERVED and isinstance(self.conditioning, TensorsEntry):
                yield f"request.inputs: {spec.name} is a name that requests with a cost map have"

    def _answer_faults(self) -> Iterator[str]:
        for name in self.answer.arrays:
            if name not in ARRAY_DTYPES or name == "trajectories":
                known = ", ".join(list(ARRAY_DTYPES)[1:])
                yield f"answer.arrays: {name!r} is none of {known}"

    @property
    def D(self) -> int:
        """Components of a position."""
        return len(self.answer.components)

    def card(self, *, sha256: str) -> ModelCard:
        """What callers see of it; sha256 is that of the manifest's bytes."""
        answer = self.answer
        return ModelCard(
            name=self.name,
            version=self.version,
            sha256=sha256,
            planner=self.planner,
            inputs=self.request.inputs,
            conditioning=self.conditioning.spec(),
            sampler=self.sampler.spec(),
            finish=self.finish.spec(),
            time=TimeSpec(self.time.steps, self.time.first_s, self.time.dt),
            answer=AnswerSpec(answer.components, answer.arrays, answer.extras),
            quality=self.quality,
            training=self.training,
        )

    def to_json(self) -> bytes:
        """The bytes of manifest.json."""
        return self.model_dump_json(indent=2).encode() + b"\n"


def parse_manifest(data: bytes) -> Manifest:
    """Check the bytes of manifest.json; ValueError says every field that is wrong, and how."""
    _check_format(data)
    try:
        return Manifest.model_validate_json(data, strict=True)
    except ValidationError as error:
        wrong = "; ".join(_describe(item) for item in error.errors())
        raise ValueError(wrong) from error


def _check_format(data: bytes) -> None:
    """A bundle of another format has one thing wrong, and not twenty fields."""
    try:
        found = json.loads(data).get("format")
    except (ValueError, AttributeError, RecursionError):
        return  # the manifest's own check says what is wrong
    if isinstance(found, int) and found != FORMAT:
        again = "export its checkpoint anew with `anchorflow export CHECKPOINT --out FOLDER`"
        raise ValueError(f"format: expected {FORMAT}, got {found}: {again}")


def _describe(item: Any) -> str:
    path = ".".join(str(part) for part in item["loc"])
    return f"{path}: {item['msg']}" if path else item["msg"]
