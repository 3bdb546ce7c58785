"""The parts of a planner that its card names by kind: conditioning, sampler, finish.

Each part says its `kind` and what a caller may want to know of it. A service's manifest is made of
the same parts; a card of a later version may hold kinds that are not known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, TypeAlias

from anchorflow_client.contract.fields import SamplerChoice
from anchorflow_client.contract.rows import uniform_schedule
from anchorflow_client.contract.sampling import OdeSpec, RefineSpec
from anchorflow_client.errors import InvalidRequest


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
    """m, of a raster [B,…,H,W] seen from above, in the frame of the anchors: least and greatest x,
    least and greatest y. Its first row lies at the greatest x, its first column at the greatest y.
    """
    optional: bool = False
    """Of a request's input: it may be left out, and the answer tells where it was."""

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> TensorSpec:
        """Read `asdict` back, lists in place of tuples included."""
        limits, extent = value.get("range"), value.get("extent")
        return cls(
            name=value["name"],
            dtype=value["dtype"],
            shape=tuple(value["shape"]),
            unit=value.get("unit", ""),
            range=None if limits is None else tuple(limits),
            extent=None if extent is None else tuple(extent),
            optional=value.get("optional", False),
        )


@dataclass(frozen=True)
class TimeSpec:
    """When an anchor's poses are: `first_s + k dt`, k from 0 to `steps` - 1."""

    steps: int
    first_s: float
    """0 where the first pose is the present one."""
    dt: float | None
    """s between two poses; None: each anchor has its own, which the answer tells."""


@dataclass(frozen=True)
class AnswerSpec:
    """What an answer holds beside its trajectories [N,T,D]."""

    components: tuple[str, ...]
    """Of a pose, such as x, y, heading: D of them."""
    arrays: tuple[str, ...] = ()
    """Which of velocities, accelerations, scores, clearance and safe are always there."""
    extras: tuple[TensorSpec, ...] = ()
    """What is sent along where a request's `outputs` name it."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of all arrays that an answer may hold."""
        return ("trajectories", *self.arrays, *(spec.name for spec in self.extras))

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> AnswerSpec:
        """Read `asdict` back."""
        extras = tuple(map(TensorSpec.from_dict, value.get("extras", ())))
        return cls(tuple(value["components"]), tuple(value.get("arrays", ())), extras)


@dataclass(frozen=True)
class LimitsSpec:
    """What the anchors of a cost-map planner keep, as far as a request says nothing else."""

    horizon_s: float | None
    """s from an anchor's first pose to its last; None: each anchor has its own duration."""
    v_max: float
    """m/s in the plane."""
    a_max: float
    """m/s^2 in the plane."""
    robot_radius: float
    """m."""


@dataclass(frozen=True)
class CostMapSpec:
    """Asked with a cost map, a state, a goal and a style."""

    channels: int
    """The most that a map may have."""
    H: int
    W: int
    """The grid that the model was trained on; the service takes maps of other sizes too."""
    limits: LimitsSpec
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """The limits that a request may set, each between the least and the greatest for which the
    model was trained; any other is the model's own."""
    kind: Literal["cost_map"] = "cost_map"

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> CostMapSpec:
        """Read `asdict` back."""
        limits = LimitsSpec(**known_fields(LimitsSpec, value["limits"]))
        ranges = {name: (low, high) for name, (low, high) in value.get("ranges", {}).items()}
        return cls(value["channels"], value["H"], value["W"], limits, ranges)


@dataclass(frozen=True)
class TensorsSpec:
    """Asked with the tensors and texts that the card lists as inputs."""

    kind: Literal["tensors"] = "tensors"


@dataclass(frozen=True)
class VisionLanguageSpec:
    """Asked with pictures of any size and a text, which the service makes tokens of."""

    image_size: int
    """Pixels along a side of what the model sees; pictures sent so are not resized."""
    max_tokens: int
    """Of the text."""
    kind: Literal["vision_language"] = "vision_language"


@dataclass(frozen=True)
class VocabularySpec:
    """Chooses the best N of a fixed number of trajectories, which it may refine."""

    size: int
    """The most anchors that a request may ask for."""
    kind: Literal["vocabulary"] = "vocabulary"


@dataclass(frozen=True)
class TruncatedDiffusionSpec:
    """A diffusion that begins near fixed trajectories, and chooses the best of what it makes."""

    size: int
    """The most anchors that a request may ask for: those that are scored finely."""
    candidates: int
    """How many are scored coarsely for them."""
    steps: int
    """Of denoising."""
    choices: tuple[int, ...] = ()
    """The numbers of steps that a request may ask for, as `sampler.schedule` {"uniform": n}."""
    kind: Literal["truncated_diffusion"] = "truncated_diffusion"

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> TruncatedDiffusionSpec:
        """Read `asdict` back."""
        choices = tuple(value.get("choices", ()))
        return cls(value["size"], value["candidates"], value["steps"], choices)

    def chosen(self, choice: SamplerChoice) -> TruncatedDiffusionSpec:
        """With the number of steps that a request asks for.

        Raises:
            InvalidRequest: it asks for a method, or for another number than those of `choices`.
        """
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
class NoFinish:
    """Anchors are answered as they were sampled."""

    kind: Literal["none"] = "none"


@dataclass(frozen=True)
class UnknownPart:
    """A part of a kind that this version does not know."""

    kind: str


ConditioningSpec: TypeAlias = CostMapSpec | TensorsSpec | VisionLanguageSpec | UnknownPart
SamplerSpec: TypeAlias = OdeSpec | VocabularySpec | TruncatedDiffusionSpec | UnknownPart
FinishSpec: TypeAlias = RefineSpec | NoFinish | UnknownPart

CONDITIONINGS: Mapping[str, type] = {
    "cost_map": CostMapSpec,
    "tensors": TensorsSpec,
    "vision_language": VisionLanguageSpec,
}
SAMPLERS: Mapping[str, type] = {
    "ode": OdeSpec,
    "vocabulary": VocabularySpec,
    "truncated_diffusion": TruncatedDiffusionSpec,
}
FINISHES: Mapping[str, type] = {"spline": RefineSpec, "none": NoFinish}


def part_of(value: Mapping[str, Any], kinds: Mapping[str, type]) -> Any:
    """The part that a card's JSON holds."""
    part = kinds.get(value["kind"])
    if part is None:
        return UnknownPart(value["kind"])
    if hasattr(part, "from_dict"):
        return part.from_dict(value)
    return part(**known_fields(part, value))


def known_fields(kind: type, value: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a dataclass that a card's JSON holds; a later version may write more."""
    return {item.name: value[item.name] for item in fields(kind) if item.name in value}
