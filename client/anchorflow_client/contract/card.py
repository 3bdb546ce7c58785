"""The model card: a bundle's inputs, outputs, defaults and measured quality."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from anchorflow_client.contract.kinds import (
    CONDITIONINGS,
    FINISHES,
    SAMPLERS,
    AnswerSpec,
    ConditioningSpec,
    CostMapSpec,
    FinishSpec,
    OdeSpec,
    SamplerSpec,
    TensorSpec,
    TimeSpec,
    part_of,
    read,
)
from anchorflow_client.errors import InvalidRequest


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

        Raises:
            KeyError, TypeError, ValueError, AttributeError: a key is missing, or its value is of
                another type than the card's.
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
