"""The manifest: the description of a bundle in manifest.json.

The reader validates it and the exporter writes it with the same classes; `entries` holds those of a
planner's conditioning, sampler and finish.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PositiveInt,
    ValidationError,
    model_validator,
)

from anchorflow_client.contract import (
    AnchorBatch,
    AnswerSpec,
    CostMapSpec,
    ModelCard,
    NoFinish,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    VocabularySpec,
)
from anchorflow_client.contract.batch import ARRAY_DTYPES, FUTURES
from anchorflow_client.contract.card import CONDITIONINGS, FINISHES, SAMPLERS, part_of
from anchorflow_client.contract.fields import LIMITS
from anchorflow_client.oip_codec import RESERVED
from anchorflow_service.bundle.entries import (
    GuardEntry,
    OdeEntry,
    SplineEntry,
    TruncatedDiffusionEntry,
    VisionLanguageEntry,
)

FORMAT = 2
FILE_NAME = "manifest.json"
OTHERS = "others"
"""The input that tells who else is there, of the graph `futures`."""
RAW_POSITIONS = "raw_positions"
"""An extra of every spline finish: the positions as they were sampled, before it."""
FIELDS_OF_ANSWER = {item.name for item in fields(AnchorBatch)}

# One path segment: a bundle never reads beside its own folder.
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


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
        if FUTURES in self.graphs:
            yield from self._futures_faults(self.graphs[FUTURES])

    def _futures_faults(self, graph: GraphEntry) -> Iterator[str]:
        asked = [spec.name for spec in self.request.inputs]
        for name in graph.input_names:
            if name not in asked:
                yield f"graphs.{FUTURES}.inputs: {name!r} is not one of {', '.join(asked)}"
        if OTHERS not in graph.input_names:
            yield f"graphs.{FUTURES}.inputs: expected {OTHERS}, got {', '.join(graph.input_names)}"
        extras = {spec.name for spec in self.answer.extras}
        for name in graph.output_names:
            if name not in extras:
                yield f"graphs.{FUTURES}.outputs: {name!r} is none of the extras"

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
    def sampled_extras(self) -> tuple[TensorSpec, ...]:
        """Extras that the sampler's graphs give; the others are outputs of the graph `futures`."""
        own = self.graphs[FUTURES].output_names if FUTURES in self.graphs else ()
        return tuple(spec for spec in self.answer.extras if spec.name not in own)

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
