"""A planner's adapter: its graphs, its part of the manifest, and the requests that prove it.

The five planners' are in `planners/`. `trace` exports the graphs of any adapter, and
`parity.prove_parity` compares them with the network.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch

from anchorflow_client.contract import (
    AnchorRequest,
    AnswerSpec,
    CostMapSpec,
    ModelCard,
    NoFinish,
    SamplerChoice,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    VocabularySpec,
)
from anchorflow_export.tracing import TracedGraph, random_tensor, trace
from anchorflow_models.torch_graphs import Role
from anchorflow_service.bundle.entries import (
    GuardEntry,
    OdeEntry,
    SplineEntry,
    TruncatedDiffusionEntry,
    VisionLanguageEntry,
)
from anchorflow_service.bundle.manifest import GraphEntry
from anchorflow_service.engine.interfaces import Arrays
from anchorflow_trajectory.finish.refiner import DESCENT_RATE
from anchorflow_trajectory.motion import MotionLimits

F32 = "float32"
COMPONENTS = ("x", "y", "heading")  # of a pose
# Limits of a model whose data say nothing of them.
USUAL_LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
USUAL_RANGES = {"horizon_s": (1.0, 120.0)}

Sizes = Mapping[str, int]
"""Sizes of open axes, by letter."""


@dataclass(frozen=True, kw_only=True)
class ExportChoices:
    """Choices at export; `planners.USES` lists those that each planner takes.

    sampler: over the planner's own default
    noise_scale: spread of the noise; 1: as in training
    limits: v_max, a_max and horizon_s of the card, None if each anchor has its own duration
    ranges: least and greatest value of the limits that a request may set
    robot_radius, safety_margin: m, defaults of the card
    refine_steps: descents on each anchor; refine_rate: m, of the first of them
    score: weights of a trajectory's score that replace the configuration's, by name
    goal_inputs: whether a request may bring goals and score weights of its own
    """

    sampler: SamplerChoice = field(default_factory=SamplerChoice)
    noise_scale: float = 1.0
    limits: MotionLimits = USUAL_LIMITS
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=USUAL_RANGES.copy)
    robot_radius: float = 0.25
    safety_margin: float = 0.1
    refine_steps: int = 20
    refine_rate: float = DESCENT_RATE
    score: Mapping[str, float] = field(default_factory=dict)
    goal_inputs: bool = False


@dataclass(frozen=True, kw_only=True)
class PlannerParts:
    """A planner's part of the manifest, beside its graphs.

    inputs: of a request
    files: beside the graphs, by role: a name and the bytes
    """

    inputs: tuple[TensorSpec, ...]
    conditioning: CostMapSpec | TensorsSpec | VisionLanguageEntry
    sampler: OdeEntry | VocabularySpec | TruncatedDiffusionEntry
    finish: SplineEntry | GuardEntry | NoFinish
    time: TimeSpec
    answer: AnswerSpec
    files: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)


def random_own(specs: Sequence[TensorSpec], _given: Arrays, sizes: Sizes, seed: int) -> Arrays:
    """Return random numbers in the ranges of the specs."""
    generator = torch.Generator().manual_seed(seed)
    return {spec.name: random_tensor(spec, sizes, generator=generator).numpy() for spec in specs}


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannerAdapter:
    """A network on its way to a bundle.

    roles: its graphs by role, in an order in which each follows those whose outputs it takes
    own: inputs of graphs that neither a request nor an earlier graph gives in this form
    request: a random request for the card, with open axes of these sizes, of a seed
    trials: sizes at which the graphs are compared with torch; none is that of the trace
    scene_inputs: inputs of graphs that a scene of a request gives
    draw: values of `own`, from those and the outputs of earlier graphs
    unordered: outputs whose rows may change places if scores are nearly equal, by role; the first
        identifies a row
    sample_sizes, num_samples, samplers: of the requests whose samples are compared
    """

    parts: PlannerParts
    roles: Mapping[str, Role]
    own: tuple[TensorSpec, ...] = ()
    request: Callable[[ModelCard, Sizes, int], AnchorRequest]
    trials: Sequence[Sizes]
    scene_inputs: tuple[str, ...] = ()
    draw: Callable[[Sequence[TensorSpec], Arrays, Sizes, int], Arrays] = random_own
    unordered: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sample_sizes: Sizes = field(default_factory=lambda: {"B": 2})
    num_samples: int | None = None
    samplers: Sequence[SamplerChoice | None] = (None,)

    def trace(self, role: str, earlier: Mapping[str, TracedGraph | GraphEntry]) -> TracedGraph:
        """Export one graph, which may read the outputs of earlier ones.

        Raises `ExportError` if it cannot be traced, or holds only for the sizes of the trace.
        """
        given = {spec.name: spec for spec in (*self.parts.inputs, *self.own)}
        for graph in earlier.values():
            for spec in graph.outputs:
                given.setdefault(spec.name, as_input(spec))
        module = self.roles[role]
        inputs = tuple(given[each] for each in module.inputs)
        return trace(module, inputs=inputs, outputs=module.outputs)


def as_input(spec: TensorSpec) -> TensorSpec:
    """Return an output's spec as the input of a later graph, which takes one of K times at once.

    An axis whose size the earlier graph computes gets a name.
    """
    axes = (each for each in spec.shape if each != "K")
    named = ("M" if isinstance(each, str) and not each.isidentifier() else each for each in axes)
    return replace(spec, shape=tuple(named))
