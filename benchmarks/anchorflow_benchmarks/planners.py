"""The planners that benchmarks compare: one interface, and bundles behind it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.scene_files import load_scenes
from anchorflow_client.contract import (
    EIGHT_STEP_SCHEDULE,
    AnchorRequest,
    CostMap,
    ModelCard,
    OdeSpec,
    RefineChoice,
    ResolvedRequest,
    SamplerChoice,
    resolve_for_card,
    uniform_schedule,
)
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.bundle import Bundle, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_trajectory.motion import MotionLimits, nominal_duration, ramp_share, time_along
from anchorflow_trajectory.ode.methods import method_named
from anchorflow_trajectory.routes.search import polyline_length
from anchorflow_trajectory.routes.splines import LEAST_WAY
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import Ends, SplineBasis, Splines

Array = NDArray[np.float64]

NUM_SAMPLES = 64  # T of the baselines' anchors
COST_MAP = "cost_map"
CARD = "card"
SAMPLER_FORM = re.compile(r"(?P<method>\w+):(?:uniform(?P<steps>\d+)|(?P<name>\w+))")


@dataclass(frozen=True)
class Proposals:
    """Anchors of one scene from any planner.

    positions, velocities, accelerations: [N, T, D] in m, m/s, m/s^2
    dt: s between samples, one for all anchors or [N]
    safe: [N] the planner's own verdict, None if it has none
    scores: [N] minus the cost, None if not computed
    """

    positions: Array
    velocities: Array
    accelerations: Array
    dt: float | Array
    safe: NDArray[np.bool_] | None = None
    scores: Array | None = None

    @property
    def dts(self) -> Array:
        """[N] s between two samples of each anchor."""
        return np.broadcast_to(np.asarray(self.dt, np.float64), len(self.positions))

    @property
    def durations(self) -> Array:
        """[N] s from the first to the last sample."""
        return self.dts * (self.positions.shape[1] - 1)

    @staticmethod
    def of_spline(
        basis: SplineBasis, splines: Splines, *, safe: NDArray[np.bool_] | None = None
    ) -> Proposals:
        """Sample N splines."""
        position, velocity, acceleration = (
            state.astype(np.float64) for state in basis.states(splines)
        )
        dt = splines.duration / (basis.num_samples - 1)
        return Proposals(position, velocity, acceleration, dt, safe)


class Planner(Protocol):
    """Proposes `num` anchors for a scene and its style; equal seeds draw equal noise."""

    @property
    def name(self) -> str:
        """Name in the tables."""
        ...

    @property
    def evaluations(self) -> int | None:
        """Evaluations of the vector field per plan; None without a field."""
        ...

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        """Do all the work of a request: this call is timed."""
        ...


@dataclass(frozen=True)
class EnginePlanner:
    """A bundle in this process with one sampler and one guidance scale.

    limits: of the robot that asks; None for the card's
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
    return AnchorRequest.build(
        cost_map=CostMap.build(
            scene.cost_map, scene.resolution, scene.origin, scene.channel_weights
        ),
        x_curr=scene.x_curr,
        x_goal=scene.x_goal,
        w_style=scene.w_style,
        num_samples=num,
        robot_radius=scene.robot_radius,
        cost_penalty=scene.cost_penalty,
        seed=seed,
        sampler=SamplerChoice(sampler.method, sampler.schedule),
    )


def requests_on(bundle: Bundle, scenes: str, *, num: int, sampler: str) -> list[AnchorRequest]:
    """Build a request for each scene of a source.

    Raises `BenchmarkError` if the sampler is unknown, or the scenes cannot be read.
    """
    spec = parse_sampler(sampler, bundle.card)
    found = load_scenes(scenes, limits=limits_of(bundle))
    return [request_of(scene, num=num, seed=1, sampler=spec) for scene in found]


def scene_of(request: ResolvedRequest) -> Scene:
    """Return the scene of a request for one scene: the inverse of `request_of`."""
    assert request.limits is not None  # the card has a cost map
    cost_map = request.cost_map
    return Scene(
        cost_map=cost_map.data[0],
        resolution=cost_map.resolution,
        origin=cost_map.origin,
        robot_radius=request.limits.robot_radius,
        x_curr=request.x_curr[0],
        x_goal=request.x_goal[0],
        w_style=request.w_style[0],
        motion=MotionLimits(request.limits.v_max, request.limits.a_max, request.limits.horizon_s),
        certified_margin=request.certified_margin,
        cost_penalty=request.cost_penalty,
        channel_weights=cost_map.channel_weights,
    )


def driven_along(
    paths: Sequence[NDArray[np.floating]], basis: SplineBasis, ends: Ends, *, limits: MotionLimits
) -> Splines:
    """Fit a spline to each polyline [P, 2], as fast as the limits allow or within the horizon."""
    lengths = [max(polyline_length(path), LEAST_WAY) for path in paths]
    duration = np.array([limits.horizon_s or nominal_duration(way, limits) for way in lengths])
    timed = [
        time_along(path, basis.num_samples, ramp=ramp_share(float(lasts), way, limits))
        for path, lasts, way in zip(paths, duration, lengths, strict=True)
    ]
    return basis.fit_positions(np.stack(timed), ends, duration)


def engine_planners(
    bundles: Sequence[Bundle],
    samplers: Sequence[str],
    *,
    guidance: Sequence[float] = (0.0,),
    limits: MotionLimits | None = None,
    threads: int | None = None,
) -> list[EnginePlanner]:
    """Return each bundle with each sampler and guidance scale.

    Raises `BundleError` if a graph of a bundle cannot be opened; `BenchmarkError` if a sampler is
    unknown.
    """
    return [
        EnginePlanner(
            f"{name} {sampler_name(sampler)}" + (f" guidance {scale:g}" if scale else ""),
            engine,
            sampler,
            scale,
            limits,
        )
        for name, bundle in zip(bundle_names(bundles), bundles, strict=True)
        for engine in [Engine(bundle, threads=threads)]
        # The card's own sampler may also be listed by name.
        for sampler in dict.fromkeys(parse_sampler(text, bundle.card) for text in samplers)
        for scale in guidance
    ]


def open_bundle(folder: Path) -> Bundle:
    """Load a bundle whose planner takes a cost map.

    Raises `BundleError` if the bundle is broken; `BenchmarkError` if the planner takes no cost map,
    so it has no scene to judge anchors on.
    """
    bundle = load_bundle(folder)
    kind = bundle.card.conditioning.kind
    if kind != COST_MAP:
        raise BenchmarkError(
            f"{bundle.card.name}: expected a planner of cost maps, got conditioning {kind!r}; "
            "the judge of anchors on a cost map does not apply to it"
        )
    return bundle


def bundle_names(bundles: Sequence[Bundle]) -> list[str]:
    """Name bundles apart: by model, by model and folder, or by model and path."""
    names = [bundle.card.name for bundle in bundles]
    paths = [bundle.path.resolve() for bundle in bundles]
    for places in ([path.name for path in paths], paths):
        if len(set(names)) < len(names):
            names = [f"{b.card.name} ({at})" for b, at in zip(bundles, places, strict=True)]
    return names


def limits_of(bundle: Bundle) -> MotionLimits:
    """Return the default limits of a bundle."""
    limits = bundle.card.cost_map.limits
    return MotionLimits(limits.v_max, limits.a_max, limits.horizon_s)


def parse_sampler(text: str, card: ModelCard) -> OdeSpec:
    """Return the sampler `METHOD:8step` or `METHOD:uniformN`; `card` is the card's own.

    Raises `BenchmarkError` if the text has another form, or the contract has no such sampler.
    """
    if text == CARD:
        return card.ode
    match = SAMPLER_FORM.fullmatch(text)
    if match is None:
        raise BenchmarkError(
            f"expected {CARD}, METHOD:8step or METHOD:uniformN for a sampler, got {text!r}"
        )
    schedule = {"uniform": int(match["steps"])} if match["steps"] else match["name"]
    try:
        choice = SamplerChoice.from_fields({"method": match["method"], "schedule": schedule})
    except InvalidRequest as error:
        raise BenchmarkError(f"sampler {text!r}: {error}") from error
    return choice.over(card.ode)


def sampler_name(sampler: OdeSpec) -> str:
    """Return the name that `parse_sampler` takes, if the schedule has one."""
    steps = len(sampler.schedule) - 1
    schedules = {EIGHT_STEP_SCHEDULE: "8step", uniform_schedule(steps): f"uniform{steps}"}
    return f"{sampler.method}:{schedules.get(sampler.schedule, f'{steps} steps')}"


def evaluations(sampler: OdeSpec) -> int:
    """Count the field evaluations of one sample."""
    return method_named(sampler.method).stages * (len(sampler.schedule) - 1)
