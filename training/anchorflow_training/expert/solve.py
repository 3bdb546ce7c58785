"""Solve a scene: many tries, descended together, the good ones kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.expert.grid_paths import alternative_paths
from anchorflow_trajectory.cost import MotionLimits, TrajectoryCost
from anchorflow_trajectory.descent import descend, whitening
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline import SplineBasis, spline_basis
from anchorflow_trajectory.time_law import time_along
from anchorflow_trajectory.verify import verify

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class ExpertConfig:
    """How hard the expert tries.

    tries: descents a scene, spread over `paths` grid paths; steps: of each descent
    spread: standard deviation [m], at its widest, of the disturbance that tells tries on one path
        apart
    """

    num_samples: int = 64
    tries: int = 32
    paths: int = 6
    steps: int = 100
    rate: float = 0.3
    spread: float = 0.25
    margin: float = 0.06


@dataclass(frozen=True)
class Solution:
    """Control points [D, M, K] of every try, with what they achieve.

    cost: [M] J for the scene's style; clearance: [M] m; good: [M] safe, as the service says it
    """

    control: FloatArray
    cost: FloatArray
    clearance: FloatArray
    good: NDArray[np.bool_]


def solve(
    scene: Scene, *, config: ExpertConfig, limits: MotionLimits, rng: np.random.Generator
) -> Solution:
    """Try `config.tries` descents on the scene."""
    basis = spline_basis(config.num_samples, limits.horizon_s)
    cost = TrajectoryCost(basis, scene.cost_fields, limits, scene.w_style, config.margin)
    control = descend(
        cost, _guesses(scene, basis, config, rng), steps=config.steps, rate=config.rate
    )
    verdict = verify(basis.states(control), scene.cost_fields.clearance, limits)
    return Solution(control, cost.value(control), verdict.clearance, verdict.safe)


def _guesses(
    scene: Scene, basis: SplineBasis, config: ExpertConfig, rng: np.random.Generator
) -> FloatArray:
    """Disturbed splines along the grid paths, [D, tries, K]."""
    start, goal = scene.x_curr[:2], scene.x_goal[:2]
    paths = alternative_paths(
        scene.clearance_field,
        scene.resolution,
        scene.origin,
        start,
        goal,
        count=config.paths,
        rng=rng,
    )
    timed = np.stack([time_along(path, basis.num_samples) for path in paths])
    seeds = basis.fit_positions(timed, scene.x_curr, scene.x_goal)
    # The cheap paths get more tries than the dear ones.
    shares = 0.75 ** np.arange(len(paths))
    which = np.sort(rng.choice(len(paths), config.tries, p=shares / shares.sum()))
    which[: len(paths)] = np.arange(len(paths))
    control = seeds[:, which]
    # Smooth, and small at both ends: a kink there takes the descent longest to iron out.
    noise = rng.normal(0.0, config.spread, control[..., basis.free].shape) @ whitening(basis).T
    noise[:, : len(paths)] = 0.0
    control[..., basis.free] += noise
    return control
