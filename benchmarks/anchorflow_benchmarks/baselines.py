"""What a bundle has to beat without a network: the expert, noisy lines, a search for routes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.finish import basis_of, finished, unfinished_scene
from anchorflow_benchmarks.path_splines import driven_along
from anchorflow_benchmarks.planners import NUM_SAMPLES, Planner, limits_of, without_fields
from anchorflow_benchmarks.routes_planner import DESCENTS, RoutesPlanner
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import SplineEntry
from anchorflow_training.expert import ExpertConfig, solve
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline import SplineBasis, Splines, spline_basis

EXPERT_STEPS = (60, 200)


@dataclass(frozen=True)
class ExpertPlanner:
    """The expert's optimiser with `num` tries, all of which are answered, good or not."""

    limits: MotionLimits
    steps: int
    evaluations: None = None

    @property
    def name(self) -> str:
        return f"expert, {self.steps} steps"

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        config = ExpertConfig(num_samples=NUM_SAMPLES, tries=num, steps=self.steps)
        scene, rng = without_fields(scene, self.limits), np.random.default_rng(seed)
        solution = solve(scene, config=config, rng=rng)
        return Proposals.of_spline(scene.basis, solution.splines, safe=solution.good)


@dataclass(frozen=True)
class LinesPlanner:
    """Straight lines, bent sideways by smooth noise, each driven as quickly as the limits allow.

    spread: m, standard deviation of the first and widest of the bends
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
        """What `plan` samples, on another basis."""
        start, span = scene.x_curr[:2], scene.x_goal[:2] - scene.x_curr[:2]
        share = np.linspace(0.0, 1.0, NUM_SAMPLES)
        across = np.array([-span[1], span[0]]) / max(1e-6, float(np.linalg.norm(span)))
        offset = self._bends(share, num, np.random.default_rng(seed))
        paths = start + share[:, None] * span + offset[..., None] * across
        return driven_along(list(paths), basis, scene.ends, limits=self.limits)

    def _bends(
        self, along: NDArray[np.float64], num: int, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Sideways offsets [num, T] in m that vanish at both ends."""
        order = np.arange(1, self.bends + 1)
        size = rng.normal(0.0, self.spread / order**2, (num, self.bends))
        return size @ np.sin(np.pi * order[:, None] * along)


@dataclass(frozen=True)
class RefinedLinesPlanner:
    """The same lines, finished as a bundle's anchors are: what its network has to earn."""

    lines: LinesPlanner
    refine: SplineEntry
    name: str = "lines with noise, refined"
    evaluations: None = None

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        splines = self.lines.splines(scene, basis_of(self.refine), num=num, seed=seed)
        scene = unfinished_scene(scene, self.lines.limits, self.refine)
        return finished(splines, np.zeros(num, np.intp), scene, self.refine)


def minimum_jerk(num_samples: int) -> NDArray[np.float64]:
    """Share of the way covered at equal times, at rest at both ends (Flash & Hogan, 1985): [T]."""
    tau = np.linspace(0.0, 1.0, num_samples)
    return tau**3 * (10.0 - 15.0 * tau + 6.0 * tau**2)


def _expert(_: Bundle, limits: MotionLimits) -> list[Planner]:
    return [ExpertPlanner(limits, steps) for steps in EXPERT_STEPS]


def _lines(bundle: Bundle, limits: MotionLimits) -> list[Planner]:
    lines = LinesPlanner(limits)
    finish = bundle.manifest.finish
    return [
        lines,
        *([RefinedLinesPlanner(lines, finish)] if isinstance(finish, SplineEntry) else []),
    ]


def _routes(bundle: Bundle, limits: MotionLimits) -> list[Planner]:
    """None for a bundle whose finish is no spline."""
    finish = bundle.manifest.finish
    if not isinstance(finish, SplineEntry):
        return []
    return [RoutesPlanner(limits, finish, descents) for descents in DESCENTS]


def _rrt(_: Bundle, limits: MotionLimits) -> list[Planner]:
    from anchorflow_benchmarks.rrt_connect import RrtConnectPlanner  # OMPL is not everywhere

    return [RrtConnectPlanner(limits)]


BASELINES: dict[str, Callable[[Bundle, MotionLimits], list[Planner]]] = {
    "expert": _expert,
    "lines": _lines,
    "routes": _routes,
    "rrt": _rrt,
}


def named_baselines(
    names: Sequence[str], bundle: Bundle, limits: MotionLimits | None = None
) -> list[Planner]:
    """The baselines of these names with the refinement of a bundle, to its limits unless told.

    Raises:
        BenchmarkError: there is none of that name.
        ModuleNotFoundError: rrt is asked for and OMPL is not installed.
    """
    if unknown := [name for name in names if name not in BASELINES]:
        raise BenchmarkError(f"expected baselines of {', '.join(BASELINES)}, got {unknown[0]!r}")
    limits = limits or limits_of(bundle)
    return [planner for name in names for planner in BASELINES[name](bundle, limits)]
