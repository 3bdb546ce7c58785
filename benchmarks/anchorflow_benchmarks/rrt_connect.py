"""RRT-Connect (Kuffner & LaValle, 2000) from OMPL as a baseline.

OMPL simplifies each path; the time law and spline are those of the other baselines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base, geometric, util  # pyright: ignore[reportMissingImports]  # optional

from anchorflow_benchmarks.planners import (
    NUM_SAMPLES,
    Proposals,
    driven_along,
)
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import spline_basis

FloatArray = NDArray[np.float32]
State = Any  # two numbers; OMPL's stubs do not type the index

CHECK_STEP = 0.04  # m between the points that are checked along a motion
LOOKUP = 0.02  # m, cell size of the grid that replaces the clearance field
TIMEOUT_S = 0.1  # per path
MAX_FAILURES = 3  # in a row, after which no more paths are tried


@dataclass(frozen=True)
class RrtConnectPlanner:
    """`num` runs of RRT-Connect; a run without a path returns the straight line.

    margin: m of clearance of the path, because the spline cuts corners; less if start or goal
        has less
    """

    limits: MotionLimits
    margin: float = 0.05
    name: str = "RRT-Connect (OMPL)"
    evaluations: None = None

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        seed_generators(seed)
        straight = np.stack([scene.x_curr[:2], scene.x_goal[:2]])
        space = _space(replace(scene, motion=self.limits), self.margin)
        paths, failures = [], 0
        for _ in range(num):
            path = _solved(space, straight) if failures < MAX_FAILURES else None
            failures = 0 if path is not None else failures + 1
            paths.append(straight if path is None else path)
        basis = spline_basis(NUM_SAMPLES)
        return Proposals.of_spline(
            basis, driven_along(paths, basis, scene.ends, limits=self.limits)
        )


_seeded: list[int] = []


def seed_generators(seed: int) -> None:
    """Seed OMPL's generators, which is possible once per process; later calls do nothing."""
    if not _seeded:
        util.setLogLevel(util.LogLevel.LOG_ERROR)
        util.RNG.setSeed(seed + 1)  # 0 is not allowed
        _seeded.append(seed)


def _space(scene: Scene, margin: float) -> base.SpaceInformation:
    """Return the square around the map as an OMPL space with a validity checker."""
    size = np.array(scene.occupied.shape[::-1]) * scene.resolution
    bounds = base.RealVectorBounds(2)  # the bindings set both axes at once
    bounds.setLow(float(scene.origin.min()))
    bounds.setHigh(float((scene.origin + size).max()))
    space = base.RealVectorStateSpace(2)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(validity(scene, margin))
    information.setStateValidityCheckingResolution(CHECK_STEP / float(np.hypot(*size)))
    information.setup()
    return information


def validity(scene: Scene, margin: float) -> Callable[[State], bool]:
    """Return a check of the margin that reads a fine grid: OMPL calls it thousands of times."""
    field = scene.cost_fields.clearance
    ends = np.stack([scene.x_curr[:2], scene.x_goal[:2]])
    margin = min(margin, float(field.sample(*ends.T).min()) - 1e-3)
    columns, rows = (
        int(np.ceil(cells * scene.resolution / LOOKUP)) for cells in scene.occupied.shape[::-1]
    )
    x, y = (
        (low + (np.arange(count) + 0.5) * LOOKUP).astype(np.float32)
        for low, count in zip(scene.origin, (columns, rows), strict=True)
    )
    free = (field.sample(x[None], y[:, None]) >= margin).tolist()
    left, bottom = scene.origin.tolist()

    def valid(state: State) -> bool:
        column, row = int((state[0] - left) / LOOKUP), int((state[1] - bottom) / LOOKUP)
        return 0 <= column < columns and 0 <= row < rows and free[row][column]

    return valid


def _solved(space: base.SpaceInformation, ends: FloatArray) -> FloatArray | None:
    """Return a simplified path [P, 2] between two points [2, 2], or None if there is no time."""
    problem = base.ProblemDefinition(space)
    problem.setStartAndGoalStates(_state(space, ends[0]), _state(space, ends[1]))
    planner = geometric.RRTConnect(space)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.timedPlannerTerminationCondition(TIMEOUT_S))
    if not problem.hasExactSolution():
        return None
    path: Any = problem.getSolutionPath()  # geometric, but typed as base
    simplifier = geometric.PathSimplifier(space)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path)
    return np.array([[state[0], state[1]] for state in path.getStates()], np.float32)


def _state(space: base.SpaceInformation, point: FloatArray) -> State:
    state: State = space.allocState()
    state[0], state[1] = float(point[0]), float(point[1])
    return state
