"""Solve a scene: many tries along each of its routes, descended together, the good ones kept."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.certificate import verify
from anchorflow_trajectory.finish.descent import descend
from anchorflow_trajectory.finish.refiner import STIFFER
from anchorflow_trajectory.routes.splines import RouteSplines
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import Splines

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class ExpertConfig:
    """How hard the expert tries.

    tries: descents a scene, dealt out in turn over its routes; steps: of each descent
    tether: what keeps them apart, as `descend` says it
    rounds: descents of what has failed, at least one, the last with the stiffest limits
    """

    num_samples: int = 64
    tries: int = 40
    steps: int = 60
    rate: float = 0.3
    tether: float = 0.2
    rounds: int = 2
    margin: float = 0.08


@dataclass(frozen=True)
class Solution:
    """Every try, with what it achieves.

    began: what each began as
    cost: [M] J for the scene's style; clearance: [M] m; good: [M] safe, as the service says it
    """

    splines: Splines
    began: RouteSplines
    cost: FloatArray
    clearance: FloatArray
    good: NDArray[np.bool_]


def solve(scene: Scene, *, config: ExpertConfig, rng: np.random.Generator) -> Solution:
    """Try `config.tries` descents on the scene."""
    tried = scene.spread_round_routes(config.tries, rng)
    fields, splines = scene.cost_fields, tried.splines
    cost = stiffer = TrajectoryCost(
        scene.basis,
        fields,
        scene.motion,
        scene.effective_style,
        scene.reference_s,
        config.margin,
    )
    failed, verdict = np.arange(config.tries), None
    for _ in range(config.rounds):
        descended = descend(
            stiffer,
            splines[failed],
            scene.ends,
            steps=config.steps,
            rate=config.rate,
            tether=config.tether,
        )
        splines = splines.replaced(failed, descended)
        verdict = verify(scene.basis.states(splines), fields.clearance, scene.motion)
        failed = np.flatnonzero(~verdict.safe)
        if not len(failed):
            break
        stiffer = replace(stiffer, weights=stiffer.weights.stiffer(STIFFER))
    assert verdict is not None, "expected at least one round"
    return Solution(splines, tried, cost.value(splines), verdict.clearance, verdict.safe)


def chosen_by_route(
    solution: Solution, count: int, *, rng: np.random.Generator
) -> NDArray[np.intp]:
    """`count` of the good tries, as many of each route as of any other; they repeat where few."""
    good = np.flatnonzero(solution.good)
    shuffled, route = rng.permutation(good), solution.began.route
    # Order by the number of each try in its route, then by route.
    order = np.zeros(len(shuffled), int)
    for label in np.unique(route[shuffled]):
        own = route[shuffled] == label
        order[own] = np.arange(own.sum())
    return np.resize(shuffled[np.argsort(order, kind="stable")], count)
