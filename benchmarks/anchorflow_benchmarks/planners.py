"""What is compared: planners that propose anchors for a scene, under one interface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.samplers import evaluations, parse_sampler, sampler_name
from anchorflow_benchmarks.scene_files import CHANNELS
from anchorflow_client.contract import (
    AnchorRequest,
    CostMap,
    OdeSpec,
    RefineChoice,
    ResolvedRequest,
    SamplerChoice,
    resolve_for_card,
)
from anchorflow_service.bundle import Bundle
from anchorflow_service.engine import Engine
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.scene import Scene, with_neutral_channels

NUM_SAMPLES = 64  # T of the baselines' anchors


class Planner(Protocol):
    """Proposes `num` anchors for a scene and its style; the same seed brings the same noise."""

    @property
    def name(self) -> str:
        """As the tables call it."""
        ...

    @property
    def evaluations(self) -> int | None:
        """Of a vector field for a plan; None where there is no field."""
        ...

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        """All that a request costs happens in here: it is what is timed."""
        ...


@dataclass(frozen=True)
class EnginePlanner:
    """A bundle in this process, with one sampler, guided by the cost as far as is asked for.

    limits: of the robot that asks; None: the card's
    """

    name: str
    engine: Engine
    sampler: OdeSpec
    guidance: float = 0.0
    limits: MotionLimits | None = None

    @property
    def evaluations(self) -> int:
        return evaluations(self.sampler)

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        request = request_of(scene, num=num, seed=seed, sampler=self.sampler)
        request = replace(request, refine=RefineChoice(guidance=self.guidance))
        if self.limits is not None:
            request = replace(request, v_max=self.limits.v_max, a_max=self.limits.a_max)
        answer = self.engine.plan(resolve_for_card(request, self.engine.card))
        states = (answer.trajectories, answer.velocities, answer.accelerations)
        position, velocity, acceleration = (state.astype(np.float64) for state in states)
        return Proposals(
            position, velocity, acceleration, answer.dt, answer.safe, answer.arrays.get("scores")
        )


def request_of(scene: Scene, *, num: int, seed: int, sampler: OdeSpec) -> AnchorRequest:
    """A scene as a caller asks for it."""
    return AnchorRequest.build(
        cost_map=CostMap.build(scene.cost_map, scene.resolution, scene.origin),
        x_curr=scene.x_curr,
        x_goal=scene.x_goal,
        w_style=scene.w_style,
        num_samples=num,
        robot_radius=scene.robot_radius,
        seed=seed,
        sampler=SamplerChoice(sampler.method, sampler.schedule),
    )


def scene_of(request: ResolvedRequest) -> Scene:
    """What a request for a single scene asks: `request_of` the other way round."""
    assert request.limits is not None  # of a card with a cost map
    cost_map = request.cost_map
    return Scene(
        cost_map=with_neutral_channels(cost_map.data[0], CHANNELS),
        resolution=cost_map.resolution,
        origin=cost_map.origin,
        robot_radius=request.limits.robot_radius,
        x_curr=request.x_curr[0],
        x_goal=request.x_goal[0],
        w_style=request.w_style[0],
        motion=MotionLimits(request.limits.v_max, request.limits.a_max, request.limits.horizon_s),
        certified_margin=request.certified_margin,
    )


def without_fields(scene: Scene, limits: MotionLimits) -> Scene:
    """The scene for these limits before any of its fields was worked out: every request pays."""
    return replace(scene, motion=limits)


def engine_planners(
    bundles: Sequence[Bundle],
    samplers: Sequence[str],
    *,
    guidance: Sequence[float] = (0.0,),
    limits: MotionLimits | None = None,
    threads: int | None = None,
) -> list[EnginePlanner]:
    """Each bundle with each sampler and each scale of guidance; the names say the folder where two
    models share a name.

    Raises:
        BundleError: a graph of a bundle cannot be opened.
        BenchmarkError: a sampler is unknown.
    """
    names = bundle_names(bundles)
    return [
        EnginePlanner(
            f"{name} {sampler_name(sampler)}{_guided(scale)}", engine, sampler, scale, limits
        )
        for name, bundle in zip(names, bundles, strict=True)
        for engine in [Engine(bundle, threads=threads)]
        # The card's own may be named beside it.
        for sampler in dict.fromkeys(parse_sampler(text, bundle.card) for text in samplers)
        for scale in guidance
    ]


def _guided(scale: float) -> str:
    return f" guidance {scale:g}" if scale else ""


def bundle_names(bundles: Sequence[Bundle]) -> list[str]:
    """What tells bundles apart: the model's name, or with it the folder's, or the whole path."""
    names = [bundle.card.name for bundle in bundles]
    paths = [bundle.path.resolve() for bundle in bundles]
    for told in ([path.name for path in paths], paths):
        if len(set(names)) < len(names):
            names = [f"{b.card.name} ({of})" for b, of in zip(bundles, told, strict=True)]
    return names


def limits_of(bundle: Bundle) -> MotionLimits:
    """What a bundle's anchors keep."""
    limits = bundle.card.cost_map.limits
    return MotionLimits(limits.v_max, limits.a_max, limits.horizon_s)
