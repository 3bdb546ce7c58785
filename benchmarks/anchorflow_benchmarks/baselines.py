"""Planners without a network: the expert's optimiser, noisy lines, a search for routes, RRT."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.planners import NUM_SAMPLES, Planner, Proposals, driven_along, limits_of
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.entries import SplineEntry
from anchorflow_training.expert import ExpertConfig, solve
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import SplineBasis, Splines, spline_basis

EXPERT_STEPS = (60, 200)
DESCENTS = (0, 5, 10, 20, 60)


@dataclass(frozen=True)
class ExpertPlanner:
    """The expert's optimiser with `num` tries; all of them are returned, good or not."""

    limits: MotionLimits
    steps: int
    evaluations: None = None

    @property
    def name(self) -> str:
        return f"expert, {self.steps} steps"

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        config = ExpertConfig(num_samples=NUM_SAMPLES, tries=num, steps=self.steps)
        scene, rng = replace(scene, motion=self.limits), np.random.default_rng(seed)
        solution = solve(scene, config=config, rng=rng)
        return Proposals.of_spline(scene.basis, solution.splines, safe=solution.good)


@dataclass(frozen=True)
class LinesPlanner:
    """Straight lines with smooth sideways noise, each as fast as the limits allow.

    spread: m, standard deviation of the first and widest bend
    """

    limits: MotionLimits
    spread: float = 1.0
    bends: int = 4
    name: str = "lines with noise"
    evaluations: None = None

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        basis = spline_basis(NUM_SAMPLES)
        return Proposals.of_spline(basis, self.splines(scene, basis, num=num, seed=seed))

    def splines(self, scene: Scene, basis: SplineBasis, *, num: int, seed: int) -> Splines:
        """Return the splines that `plan` samples, on any basis."""
        start, span = scene.x_curr[:2], scene.x_goal[:2] - scene.x_curr[:2]
        share = np.linspace(0.0, 1.0, NUM_SAMPLES)
        across = np.array([-span[1], span[0]]) / max(1e-6, float(np.linalg.norm(span)))
        size = bend_sizes(np.random.default_rng(seed), num, spread=self.spread, bends=self.bends)
        offset = bent_aside(size, share)
        paths = start + share[:, None] * span + offset[..., None] * across
        return driven_along(list(paths), basis, scene.ends, limits=self.limits)


def bend_sizes(
    rng: np.random.Generator, num: int, *, spread: float, bends: int
) -> NDArray[np.float64]:
    """Draw the sizes [num, bends] in m of sine bends; higher orders are smaller."""
    return rng.normal(0.0, spread / np.arange(1, bends + 1) ** 2, (num, bends))


def bent_aside(size: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sideways offsets [num, T] in m of bends at shares of the way; 0 at both ends."""
    order = np.arange(1, size.shape[1] + 1)
    return size @ np.sin(np.pi * order[:, None] * share)


@dataclass(frozen=True)
class RefinedLinesPlanner:
    """The same lines after a bundle's finish: the score that its network has to beat."""

    lines: LinesPlanner
    refine: SplineEntry
    name: str = "lines with noise, refined"
    evaluations: None = None

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        splines = self.lines.splines(scene, finish_basis(self.refine), num=num, seed=seed)
        scene = unfinished_scene(scene, self.lines.limits, self.refine)
        return finished(splines, np.zeros(num, np.intp), scene, self.refine)


@dataclass(frozen=True)
class RoutesPlanner:
    """Splines along the scene's routes with a smooth spread, then descents of a bundle's finish.

    This is a bundle without its flow. Each spline lasts as long as its route and style require, or
    the horizon of the limits. Without a free route the smoothest curve is used.
    """

    limits: MotionLimits
    finish: SplineEntry
    descents: int
    evaluations: None = None

    @property
    def name(self) -> str:
        return f"routes + finish, {self.descents} descents"

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        scene = unfinished_scene(scene, self.limits, self.finish)
        tried = scene.spread_round_routes(num, np.random.default_rng(seed))
        finish = with_descents(self.finish, self.descents)
        return finished(tried.splines, tried.route, scene, finish)


def spline_finish(bundle: Bundle) -> SplineEntry:
    """Return the bundle's finish; raise `BenchmarkError` unless it is a spline."""
    finish = bundle.manifest.finish
    if not isinstance(finish, SplineEntry):
        raise BenchmarkError(
            f"{bundle.card.name}: expected a bundle whose finish is a spline, got {finish.kind!r}"
        )
    return finish


def finish_basis(finish: SplineEntry) -> SplineBasis:
    """Return the spline basis of a manifest's finish."""
    return spline_basis(
        NUM_SAMPLES, num_control_points=finish.num_control_points, degree=finish.degree
    )


def with_descents(finish: SplineEntry, descents: int) -> SplineEntry:
    """Return the finish with another number of descents; with 0 it only smooths."""
    if descents:
        return replace(finish, steps=descents)
    return replace(finish, smooth=True, project=False)


def unfinished_scene(scene: Scene, limits: MotionLimits, finish: SplineEntry) -> Scene:
    """Return the scene on the basis of a finish, without its cached fields."""
    return replace(scene, motion=limits, basis=finish_basis(finish))


def finished(
    splines: Splines, route: NDArray[np.intp], scene: Scene, finish: SplineEntry
) -> Proposals:
    """Apply a bundle's finish to splines.

    route: [N] index of the route that each follows
    """
    states = scene.basis.own_time_states(splines.control)
    lasting = np.broadcast_to(np.log(splines.duration)[:, None, None], (*states.shape[:2], 1))
    refiner = Refiner(scene, finish.steps, finish.rate)
    refined = refiner.refine(np.concatenate([states, lasting], -1, dtype=np.float32), route, finish)
    arrays = (refined.positions, refined.velocities, refined.accelerations)
    position, velocity, acceleration = (array.astype(np.float64) for array in arrays)
    dt = refined.duration / (NUM_SAMPLES - 1)
    scores = refined.scores.astype(np.float64)
    return Proposals(position, velocity, acceleration, dt, refined.safe, scores)


def _lines(bundle: Bundle, limits: MotionLimits) -> list[Planner]:
    lines, finish = LinesPlanner(limits), bundle.manifest.finish
    refined = [RefinedLinesPlanner(lines, finish)] if isinstance(finish, SplineEntry) else []
    return [lines, *refined]


def _routes(bundle: Bundle, limits: MotionLimits) -> list[Planner]:
    """Return no planner for a bundle whose finish is not a spline."""
    finish = bundle.manifest.finish
    if not isinstance(finish, SplineEntry):
        return []
    return [RoutesPlanner(limits, finish, descents) for descents in DESCENTS]


def _rrt(_: Bundle, limits: MotionLimits) -> list[Planner]:
    from anchorflow_benchmarks.rrt_connect import RrtConnectPlanner  # OMPL is optional

    return [RrtConnectPlanner(limits)]


BASELINES: dict[str, Callable[[Bundle, MotionLimits], list[Planner]]] = {
    "expert": lambda _, limits: [ExpertPlanner(limits, steps) for steps in EXPERT_STEPS],
    "lines": _lines,
    "routes": _routes,
    "rrt": _rrt,
}


def named_baselines(
    names: Sequence[str], bundle: Bundle, limits: MotionLimits | None = None
) -> list[Planner]:
    """Return the baselines of these names with the finish of a bundle, within its limits.

    Raises `BenchmarkError` if a name is unknown; `ModuleNotFoundError` if rrt needs OMPL, which is
    not installed.
    """
    if unknown := [name for name in names if name not in BASELINES]:
        raise BenchmarkError(f"expected baselines of {', '.join(BASELINES)}, got {unknown[0]!r}")
    limits = limits or limits_of(bundle)
    return [planner for name in names for planner in BASELINES[name](bundle, limits)]
