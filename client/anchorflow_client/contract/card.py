"""The model card: a bundle's inputs, outputs, defaults and measured quality.

A card names its conditioning, sampler and finish by `kind`, with the facts that a caller may need.
A bundle's manifest holds the same classes: the service validates their JSON with pydantic, which
reads the bounds of a number from its field's metadata (`gt`, `ge`, `min_length`). A card of a later
version may name kinds that this version does not know; they are read as `UnknownPart`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal, TypeAlias

from anchorflow_client.contract.fields import RefineChoice, SamplerChoice
from anchorflow_client.contract.rows import uniform_schedule
from anchorflow_client.errors import InvalidRequest

ABOVE_0 = {"gt": 0}
AT_LEAST_0 = {"ge": 0}

Limit = Literal["robot_radius", "v_max", "a_max", "horizon_s"]


@dataclass(frozen=True)
class TensorSpec:
    """A tensor by name, type and axes."""

    name: str
    dtype: str
    """A numpy dtype by name, or "text"."""
    shape: tuple[str | int, ...]
    """Axis letters (B, N, T, D, C, H, W) or fixed sizes."""
    unit: str = ""
    range: tuple[float | None, float | None] | None = None
    """Least and greatest value, both allowed; None is unbounded."""
    extent: tuple[float, float, float, float] | None = None
    """For a raster [B,…,H,W] seen from above: least and greatest x, least and greatest y in m, in
    the frame of the anchors. Row 0 is at the greatest x, column 0 at the greatest
    y."""
    optional: bool = False
    """Whether a request may leave this input out; the answer lists the inputs that were absent."""


@dataclass(frozen=True)
class TimeSpec:
    """The times of an anchor's poses: `first_s + k dt`, k from 0 to `steps` - 1."""

    steps: int = field(metadata={"ge": 2})
    first_s: float = field(metadata=AT_LEAST_0)
    """Seconds from now to the first pose; 0 beside a cost map."""
    dt: float | None = field(metadata=ABOVE_0)
    """Seconds between two poses; None if each anchor has its own, which the answer holds."""


@dataclass(frozen=True)
class AnswerSpec:
    """The arrays of an answer beside its trajectories [N,T,D]."""

    components: tuple[str, ...] = field(metadata={"min_length": 2})
    """Names of the D components of a pose, such as x, y, heading."""
    arrays: tuple[str, ...] = ()
    """Which of velocities, accelerations, scores, clearance, safe and routes every answer holds."""
    extras: tuple[TensorSpec, ...] = field(default=(), metadata={"parts": TensorSpec})
    """Further outputs, sent if a request's `outputs` names them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all arrays that an answer may hold."""
        return ("trajectories", *self.arrays, *(spec.name for spec in self.extras))


@dataclass(frozen=True)
class LimitsSpec:
    """The limits that anchors of a cost-map planner keep unless a request sets others."""

    horizon_s: float | None = field(metadata=ABOVE_0)
    """Seconds from an anchor's first pose to its last; None if each anchor has its own duration."""
    v_max: float = field(metadata=ABOVE_0)
    """m/s in the plane."""
    a_max: float = field(metadata=ABOVE_0)
    """m/s^2 in the plane."""
    robot_radius: float = field(metadata=AT_LEAST_0)
    """m."""


@dataclass(frozen=True)
class CostMapSpec:
    """The planner takes a cost map, a state, a goal and a style."""

    channels: int = field(metadata=ABOVE_0)
    """Channels that the model reads; a map may have fewer or more."""
    H: int = field(metadata=ABOVE_0)
    W: int = field(metadata=ABOVE_0)
    """Rows and columns of the grid that the model was trained on; other sizes work too."""
    limits: LimitsSpec = field(metadata={"part": LimitsSpec})
    ranges: Mapping[Limit, tuple[float, float]] = field(default_factory=dict)
    """The limits that a request may set, and the least and greatest value of each; the other
    limits are fixed."""
    kind: Literal["cost_map"] = "cost_map"


@dataclass(frozen=True)
class TensorsSpec:
    """The planner takes the tensors and texts that the card lists as inputs."""

    kind: Literal["tensors"] = "tensors"


@dataclass(frozen=True)
class VisionLanguageSpec:
    """The planner takes pictures of any size and a text, which the service tokenizes."""

    image_size: int = field(metadata=ABOVE_0)
    """Pixels a side of the model's input; pictures of this size are not resized."""
    max_tokens: int = field(metadata=ABOVE_0)
    """The most tokens that a text may have."""
    kind: Literal["vision_language"] = "vision_language"


@dataclass(frozen=True)
class OdeSpec(SamplerChoice):
    """A complete solver of a flow: method by name, and schedule."""

    method: str = field()
    schedule: tuple[float, ...] = field()
    kind: Literal["ode"] = "ode"


@dataclass(frozen=True)
class RefineSpec(RefineChoice):
    """A complete refinement of splines."""

    smooth: bool = field()
    project: bool = field()
    safety_margin: float = field()
    guidance: float = field()
    barrier: bool = False
    certified_margin: float = 0.0
    kind: Literal["spline"] = "spline"


@dataclass(frozen=True)
class VocabularySpec:
    """The planner chooses the best N of a fixed set of trajectories, which it may refine."""

    size: int = field(metadata=ABOVE_0)
    """The most anchors of a request."""
    kind: Literal["vocabulary"] = "vocabulary"


@dataclass(frozen=True)
class TruncatedDiffusionSpec:
    """A diffusion that starts near fixed trajectories, then chooses the best of its candidates."""

    size: int
    """The most anchors of a request: those that are scored finely."""
    candidates: int
    """How many trajectories are scored coarsely."""
    steps: int
    """Denoising steps."""
    choices: tuple[int, ...] = ()
    """The numbers of steps that a request may choose, as `sampler.schedule` {"uniform": n}."""
    kind: Literal["truncated_diffusion"] = "truncated_diffusion"

    def chosen(self, choice: SamplerChoice) -> TruncatedDiffusionSpec:
        """Return this sampler with a request's number of steps. Raises `InvalidRequest`."""
        if choice.method is not None:
            raise InvalidRequest(
                f"expected none, as a diffusion has none, got {choice.method!r}", "sampler.method"
            )
        if choice.schedule is None:
            return self
        steps = len(choice.schedule) - 1
        if steps not in self.choices or choice.schedule != uniform_schedule(steps):
            known = ", ".join(map(str, self.choices))
            came = f"{steps} steps at {[round(t, 4) for t in choice.schedule]}"
            message = f'expected {{"uniform": n}}, n one of {known}, got {came}'
            raise InvalidRequest(message, "sampler.schedule")
        return replace(self, steps=steps)


@dataclass(frozen=True)
class GuardSpec:
    """Anchors of a car are answered as they were sampled or, with `refine.guard`, judged by what
    the planner perceives; the last of them is then a stop. With `delay_s` they begin later."""

    horizon_s: float = field(metadata=ABOVE_0)
    """Seconds for which a safe anchor meets nothing; after them a stop on its path is possible."""
    guard: bool = False
    """Whether a request is guarded that does not say."""
    route_drives: bool | None = None
    """Whether drives along the route join, likewise; None if the planner has none."""
    kind: Literal["guard"] = "guard"

    def chosen(self, choice: RefineChoice) -> GuardSpec:
        """Return this finish as a request chooses it. Raises `InvalidRequest`."""
        for name in choice.given:
            if name not in ("guard", "route_drives"):
                message = "expected none, as anchors of a car are not fitted by splines"
                raise InvalidRequest(message, f"refine.{name}")
        if choice.route_drives is not None and self.route_drives is None:
            message = "expected none, as this planner does not drive along a route by itself"
            raise InvalidRequest(message, "refine.route_drives")
        return replace(self, **choice.given)


@dataclass(frozen=True)
class NoFinish:
    """Anchors are answered as they were sampled."""

    kind: Literal["none"] = "none"


@dataclass(frozen=True)
class UnknownPart:
    """A part of a kind that this version does not know."""

    kind: str


ConditioningSpec: TypeAlias = CostMapSpec | TensorsSpec | VisionLanguageSpec | UnknownPart
SamplerSpec: TypeAlias = OdeSpec | VocabularySpec | TruncatedDiffusionSpec | UnknownPart
FinishSpec: TypeAlias = RefineSpec | GuardSpec | NoFinish | UnknownPart


def _by_kind(*parts: Any) -> Mapping[str, type]:
    return {part.kind: part for part in parts}


CONDITIONINGS = _by_kind(CostMapSpec, TensorsSpec, VisionLanguageSpec)
SAMPLERS = _by_kind(OdeSpec, VocabularySpec, TruncatedDiffusionSpec)
FINISHES = _by_kind(RefineSpec, GuardSpec, NoFinish)


def part_of(value: Mapping[str, Any], kinds: Mapping[str, type]) -> Any:
    """Read a part of a card's JSON as the class of its kind."""
    part = kinds.get(value["kind"])
    return UnknownPart(value["kind"]) if part is None else read(part, value)


def read(cls: type, value: Mapping[str, Any]) -> Any:
    """Read a dataclass back from `asdict`; keys that this version does not know are ignored.

    A JSON list becomes a tuple. A field's metadata names the class of a nested part (`part`), or
    of each of several (`parts`).

    Raises:
        TypeError, AttributeError: a field is missing, or is of another type.
    """
    return cls(
        **{each.name: _held(each, value[each.name]) for each in fields(cls) if each.name in value}
    )


def _held(item: Any, value: Any) -> Any:
    if "part" in item.metadata:
        return read(item.metadata["part"], value)
    if "parts" in item.metadata:
        return tuple(read(item.metadata["parts"], each) for each in value)
    return _frozen(value)


def _frozen(value: Any) -> Any:
    """Lists as tuples, inside mappings too."""
    if isinstance(value, list):
        return tuple(map(_frozen, value))
    if isinstance(value, dict):
        return {name: _frozen(each) for name, each in value.items()}
    return value


@dataclass(frozen=True)
class ModelId:
    """Name, version and hash of the model that answered."""

    name: str
    version: str
    sha256: str


@dataclass(frozen=True, kw_only=True)
class ModelCard:
    """A bundle's inputs, answer, samplers and limits, as a caller needs them to write a request."""

    name: str
    version: str
    sha256: str
    """The hash of the manifest's bytes."""
    planner: str
    inputs: tuple[TensorSpec, ...]
    """Inputs of a request, by name; each has a leading B axis, which one scene may leave out."""
    conditioning: ConditioningSpec
    sampler: SamplerSpec
    finish: FinishSpec
    time: TimeSpec
    answer: AnswerSpec
    quality: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)

    @property
    def id(self) -> ModelId:
        """Return the name, version and hash that every answer carries."""
        return ModelId(self.name, self.version, self.sha256)

    @property
    def T(self) -> int:
        """Time steps of an anchor."""
        return self.time.steps

    @property
    def D(self) -> int:
        """Components of a position: 2 (x, y), or 3 with heading."""
        return len(self.answer.components)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Return the names that a request's `outputs` may list: the arrays, and dt if it is one."""
        return (*self.answer.names, *(("dt",) if self.time.dt is None else ()))

    @property
    def cost_map(self) -> CostMapSpec:
        """Return the conditioning of a planner that takes a cost map.

        Raises:
            InvalidRequest: this planner takes none.
        """
        if isinstance(self.conditioning, CostMapSpec):
            return self.conditioning
        names = ", ".join(spec.name for spec in self.inputs)
        raise InvalidRequest(f"{self.name} takes no cost map; its inputs are {names}", "cost_map")

    @property
    def ode(self) -> OdeSpec:
        """Return the sampler of a planner with a flow. Raises `InvalidRequest` if it has none."""
        if isinstance(self.sampler, OdeSpec):
            return self.sampler
        raise InvalidRequest(f"{self.name} has no flow; it is a {self.sampler.kind}", "sampler")

    def to_dict(self) -> dict[str, Any]:
        """Return the card in plain types that any JSON writer takes."""
        return asdict(self)

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> ModelCard:
        """Read `to_dict` back; keys and kinds that this version does not know are ignored.

        Raises `KeyError`, `TypeError`, `ValueError` or `AttributeError` if it is no card.
        """
        return cls(
            **{each.name: value[each.name] for each in fields(cls) if each.name in value}
            | {
                "inputs": tuple(read(TensorSpec, each) for each in value["inputs"]),
                "conditioning": part_of(value["conditioning"], CONDITIONINGS),
                "sampler": part_of(value["sampler"], SAMPLERS),
                "finish": part_of(value["finish"], FINISHES),
                "time": read(TimeSpec, value["time"]),
                "answer": read(AnswerSpec, value["answer"]),
            }
        )
