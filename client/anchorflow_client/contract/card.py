"""The model card: what a bundle is, what it takes and gives, and how well it does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from anchorflow_client.contract.kinds import (
    CONDITIONINGS,
    FINISHES,
    SAMPLERS,
    AnswerSpec,
    ConditioningSpec,
    CostMapSpec,
    FinishSpec,
    SamplerSpec,
    TensorSpec,
    TimeSpec,
    known_fields,
    part_of,
)
from anchorflow_client.contract.sampling import OdeSpec
from anchorflow_client.errors import InvalidRequest


@dataclass(frozen=True)
class ModelId:
    """Which weights answered."""

    name: str
    version: str
    sha256: str


@dataclass(frozen=True, kw_only=True)
class ModelCard:
    """All that a caller may want to know of a bundle before asking it."""

    name: str
    version: str
    sha256: str
    """Of the manifest's bytes."""
    planner: str
    inputs: tuple[TensorSpec, ...]
    """What a request brings, by name; each with a leading B, which one scene may leave out."""
    conditioning: ConditioningSpec
    sampler: SamplerSpec
    finish: FinishSpec
    time: TimeSpec
    answer: AnswerSpec
    quality: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)

    @property
    def id(self) -> ModelId:
        """Name, version and hash, as every answer carries them."""
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
        """What a request's `outputs` may name: the answer's arrays, and dt where it is one."""
        return (*self.answer.names, *(("dt",) if self.time.dt is None else ()))

    @property
    def cost_map(self) -> CostMapSpec:
        """The conditioning of a planner that is asked with a cost map.

        Raises:
            InvalidRequest: this planner is asked in another way.
        """
        if isinstance(self.conditioning, CostMapSpec):
            return self.conditioning
        names = ", ".join(spec.name for spec in self.inputs)
        raise InvalidRequest(f"{self.name} takes no cost map; its inputs are {names}", "cost_map")

    @property
    def ode(self) -> OdeSpec:
        """The sampler of a planner with a flow. Raises `InvalidRequest` where it has none."""
        if isinstance(self.sampler, OdeSpec):
            return self.sampler
        raise InvalidRequest(f"{self.name} has no flow; it is a {self.sampler.kind}", "sampler")

    def to_dict(self) -> dict[str, Any]:
        """Plain types that any JSON writer takes."""
        return asdict(self)

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> ModelCard:
        """Read `to_dict` back; keys and kinds that this version does not know are passed over.

        Raises:
            KeyError, TypeError, ValueError, AttributeError: a key is missing, or holds something
                else than the card's.
        """
        return cls(
            **known_fields(cls, value)
            | {
                "inputs": tuple(map(TensorSpec.from_dict, value["inputs"])),
                "conditioning": part_of(value["conditioning"], CONDITIONINGS),
                "sampler": part_of(value["sampler"], SAMPLERS),
                "finish": part_of(value["finish"], FINISHES),
                "time": TimeSpec(**known_fields(TimeSpec, value["time"])),
                "answer": AnswerSpec.from_dict(value["answer"]),
            }
        )
