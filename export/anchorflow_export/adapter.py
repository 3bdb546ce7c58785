"""What the exporter asks of a planner; each has an adapter in `planners/`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import onnx
from torch import Tensor

from anchorflow_client.contract import SamplerChoice, TensorSpec
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import (
    AnswerEntry,
    CostMapEntry,
    NoFinishEntry,
    OdeEntry,
    SplineEntry,
    TensorsEntry,
    TimeEntry,
    TruncatedDiffusionEntry,
    VisionLanguageEntry,
    VocabularyEntry,
)
from anchorflow_trajectory.finish.refiner import DESCENT_RATE
from anchorflow_trajectory.motion import MotionLimits

# Of a model whose data say nothing of limits.
USUAL_LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
USUAL_RANGES = {"horizon_s": (1.0, 120.0)}


@dataclass(frozen=True, kw_only=True)
class ExportChoices:
    """What may be chosen at export; `planners.USES` says which planner has a use for what.

    sampler: over the planner's own default
    noise_scale: spread of the noise; 1: as in training
    limits: v_max, a_max and horizon_s of the card, None where each anchor has its own duration
    ranges: least and greatest value of the limits that a request may set
    robot_radius, safety_margin: m, defaults of the card
    refine_steps: descents on each anchor; refine_rate: m, of the first of them
    """

    sampler: SamplerChoice = field(default_factory=SamplerChoice)
    noise_scale: float = 1.0
    limits: MotionLimits = USUAL_LIMITS
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=USUAL_RANGES.copy)
    robot_radius: float = 0.25
    safety_margin: float = 0.1
    refine_steps: int = 20
    refine_rate: float = DESCENT_RATE


@dataclass(frozen=True, eq=False)
class TracedGraph:
    """An ONNX graph and its signature."""

    model: onnx.ModelProto
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]


@dataclass(frozen=True, kw_only=True)
class PlannerParts:
    """What a manifest says of the planner, beside its graphs.

    inputs: of a request
    files: beside the graphs, by role: a name and what it holds
    """

    inputs: tuple[TensorSpec, ...]
    conditioning: CostMapEntry | TensorsEntry | VisionLanguageEntry
    sampler: OdeEntry | VocabularyEntry | TruncatedDiffusionEntry
    finish: SplineEntry | NoFinishEntry
    time: TimeEntry
    answer: AnswerEntry
    files: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class GraphTrial:
    """One call of a graph: what goes in, and what torch makes of it."""

    what: str
    role: str
    inputs: Mapping[str, Tensor]
    expected: Mapping[str, Tensor]


@dataclass(frozen=True, eq=False)
class SampleTrial:
    """A whole sample: the engine's own, and torch's in a loop written the plain way.

    relative: whether the greatest expected number, where it is over 1, is what a difference is
        measured by; scores that sum logarithms can be hundreds
    """

    what: str
    got: np.ndarray
    expected: np.ndarray
    relative: bool = False


class PlannerAdapter(Protocol):
    """A torch planner on its way to a bundle."""

    @property
    def parts(self) -> PlannerParts:
        """What the manifest says of it."""
        ...

    def trace(self) -> Mapping[str, TracedGraph]:
        """Its graphs by role. Raises `ExportError` where one cannot be traced."""
        ...

    def graph_trials(self, bundle: Bundle) -> Iterator[GraphTrial]:
        """Calls of every graph, at sizes other than those of the trace."""
        ...

    def sample_trials(self, bundle: Bundle) -> Iterator[SampleTrial]:
        """Samples of the written bundle by the card's own sampler, before the finish."""
        ...
