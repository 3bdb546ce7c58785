"""The manifest: what a bundle says of itself in manifest.json.

The reader checks it and the exporter writes it with the same classes. A planner is put together of
parts by kind, each an entry of its own: how it is asked (conditioning), how anchors are drawn
(sampler), what is done to them before they are answered (finish).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    model_validator,
)

from anchorflow_client.contract import (
    AnchorBatch,
    AnswerSpec,
    ModelCard,
    NoFinish,
    RefineSpec,
    TensorSpec,
    TimeSpec,
)
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.oip_codec import RESERVED
from anchorflow_service.bundle.conditioning import (
    CostMapEntry,
    Entry,
    TensorsEntry,
    VisionLanguageEntry,
)
from anchorflow_service.bundle.samplers import OdeEntry, TruncatedDiffusionEntry, VocabularyEntry
from anchorflow_trajectory.finish.refiner import DESCENT_RATE

FORMAT = 2
FILE_NAME = "manifest.json"
FIELDS_OF_ANSWER = {item.name for item in fields(AnchorBatch)}

# One path segment: a bundle never reads beside its own folder.
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class FileEntry(Entry):
    """A file beside the graphs, such as a vocabulary or a tokenizer."""

    file: FileName
    """In the bundle's own folder."""
    sha256: Sha256
    """Of its bytes, in hexadecimal digits."""


class GraphEntry(FileEntry):
    """One ONNX graph of the bundle; the key it stands under is its role."""

    opset: PositiveInt
    """Of ONNX."""
    precision: Literal["float32", "int8"] = "float32"
    """Of its products."""
    inputs: tuple[TensorSpec, ...]
    """In the graph's order; by their names they are found among what a request brings and what
    other graphs give."""
    outputs: tuple[TensorSpec, ...]

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(spec.name for spec in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(spec.name for spec in self.outputs)


class RequestEntry(Entry):
    """What a caller sends."""

    inputs: Annotated[tuple[TensorSpec, ...], Field(min_length=1)]
    """By name; the first axis of each is B."""


class SplineEntry(Entry):
    """Splines that meet both ends: the card's defaults, as a request's `refine` has them, and the
    spline they are finished on."""

    kind: Literal["spline"] = "spline"
    smooth: bool
    project: bool
    safety_margin: NonNegativeFloat
    guidance: NonNegativeFloat
    barrier: bool = False
    certified_margin: NonNegativeFloat = 0.0
    steps: PositiveInt
    """Descents of the projection."""
    rate: PositiveFloat = DESCENT_RATE
    """m, of the first of them."""
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
    """Poses at first_s + k dt, k from 0 to steps - 1."""

    steps: Annotated[int, Field(ge=2)]
    first_s: NonNegativeFloat
    """s from now; 0 beside a cost map."""
    dt: PositiveFloat | None
    """s between two poses, above 0; null where each anchor has its own."""


class AnswerEntry(Entry):
    """What an answer holds beside its trajectories [N,T,D]."""

    components: Annotated[tuple[str, ...], Field(min_length=2)]
    """The names of D's parts."""
    arrays: tuple[str, ...] = ()
    """Which of the contract's are always there."""
    extras: tuple[TensorSpec, ...] = ()
    """Further outputs of the graphs, sent where a request asks for them."""


class Manifest(Entry):
    """manifest.json; the axes of its tensors are letters, or numbers where the graph fixes them."""

    format: Literal[2]
    name: Annotated[str, Field(min_length=1)]
    """By which requests ask for it as their `model`."""
    version: Annotated[str, Field(min_length=1)]
    planner: str
    """Of `anchorflow train --planner`, or one of your own; the service does not read it."""
    request: RequestEntry
    conditioning: Annotated[
        CostMapEntry | TensorsEntry | VisionLanguageEntry, Field(discriminator="kind")
    ]
    sampler: Annotated[
        OdeEntry | VocabularyEntry | TruncatedDiffusionEntry, Field(discriminator="kind")
    ]
    finish: Annotated[SplineEntry | NoFinishEntry, Field(discriminator="kind")]
    time: TimeEntry
    answer: AnswerEntry
    graphs: dict[str, GraphEntry]
    """By role, which the sampler's kind asks for."""
    files: dict[str, FileEntry] = Field(default_factory=dict)
    """By role; others in the folder are not read."""
    training: dict[str, Any] = Field(default_factory=dict)
    """Where the weights come from: told on the card, read by nothing."""
    quality: dict[str, Any] = Field(default_factory=dict)
    """What a benchmark measured: told likewise."""

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Manifest:
        for fault in (*self._time_faults(), *self._input_faults(), *self._answer_faults()):
            raise ValueError(fault)
        return self

    def _time_faults(self) -> Iterator[str]:
        """A planner with a cost map answers from now to the horizon, or each anchor to its end."""
        if not isinstance(self.conditioning, CostMapEntry):
            if self.time.dt is None:
                yield "time.dt is null, expected s between two poses of a planner without limits"
            return
        yield from self.conditioning.faults()
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
            if spec.name in RESERVED and not isinstance(self.conditioning, CostMapEntry):
                yield f"request.inputs: {spec.name} is a name that requests with a cost map have"

    def _answer_faults(self) -> Iterator[str]:
        for name in self.answer.arrays:
            if name not in ARRAY_DTYPES or name == "trajectories":
                known = ", ".join(list(ARRAY_DTYPES)[1:])
                yield f"answer.arrays: {name!r} is none of {known}"
        for spec in self.answer.extras:
            if spec.name in FIELDS_OF_ANSWER:
                yield f"answer.extras: {spec.name!r} is a name that every answer has"

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
