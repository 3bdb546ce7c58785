"""Ways of a body from OMPL: RRT over the curves of Reeds and Shepp, of Dubins, or straight lines.

RRT-Connect joins trees of Reeds-Shepp curves, and of lines for a robot that slides; Dubins' curves
cannot be driven back, so that RRT grows one tree. A way is simplified, and then finished and
certified as those of the search are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base, geometric  # pyright: ignore[reportMissingImports]  # optional

from anchorflow_benchmarks.rrt_connect import seed_generators
from anchorflow_trajectory.bodies.outline import touches
from anchorflow_trajectory.bodies.scene import BodyScene
from anchorflow_trajectory.bodies.ways import TRIES, Stretch, WaySearch
from anchorflow_trajectory.bodies.wheels import SLIDING

State = Any  # a pose; OMPL's stubs do not type it

TIMEOUT_S = 0.5  # of a search
LEAST_RADIUS = 0.25  # m, of a robot that can turn on the spot, which these curves do not have
CHECK_STEP, STEP = 0.04, 0.03  # m between the poses that are checked, and those of a way


class OmplWays(WaySearch):
    """The first way that OMPL finds."""

    def find(self, certified: float) -> Iterator[list[list[Stretch]]]:
        """Yield one way, or one that the body does not fit through."""
        seed_generators(0)
        way = _solved(self.problem, TRIES[-1][0] + certified)
        if way is None:
            way = self._along(self.problem.scene.routes[:1])
        yield [self._stretches(way)]


def _solved(problem: BodyScene, margin: float) -> NDArray[np.float64] | None:
    """Return a way [P, 4] of poses and the gears that lead to them, or None without one in time."""
    space = _space(problem)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(_validity(problem, margin))
    information.setStateValidityCheckingResolution(CHECK_STEP / space.getMaximumExtent())
    information.setup()
    task = base.ProblemDefinition(information)
    goal = problem.goal
    if not problem.heading_counts:  # it looks along the straight line
        goal = np.append(goal[:2], np.arctan2(*(goal - problem.start)[1::-1]))
    task.setStartAndGoalStates(_state(space, problem.start), _state(space, goal))
    wheels = problem.body.wheels
    both = wheels.reverse or wheels.slides
    planner: Any = (geometric.RRTConnect if both else geometric.RRT)(information)
    planner.setProblemDefinition(task)
    planner.setup()
    planner.solve(base.timedPlannerTerminationCondition(TIMEOUT_S))
    if not task.hasExactSolution():
        return None
    path: Any = task.getSolutionPath()  # geometric, but typed as base
    geometric.PathSimplifier(information).reduceVertices(path)
    path.interpolate(2 + int(path.length() / STEP))
    states = [(state.getX(), state.getY(), state.getYaw()) for state in path.getStates()]
    return _with_gears(np.array(states), slides=wheels.slides)


def _space(problem: BodyScene) -> Any:
    """Return the square about the map, with the curves that the wheels can drive."""
    scene, wheels = problem.scene, problem.body.wheels
    radius = TRIES[0][2] * wheels.min_radius or LEAST_RADIUS
    curves = base.ReedsSheppStateSpace if wheels.reverse else base.DubinsStateSpace
    space: Any = base.SE2StateSpace() if wheels.slides else curves(radius)
    bounds = base.RealVectorBounds(2)  # the bindings set both axes at once
    bounds.setLow(float(scene.origin.min()))
    size = np.array(scene.occupied.shape[::-1]) * scene.resolution
    bounds.setHigh(float((scene.origin + size).max()))
    space.setBounds(bounds)
    return space


def _validity(problem: BodyScene, margin: float) -> Callable[[State], bool]:
    """Return the check of a pose that the search of this project has."""
    outline, ground = problem.body.outline.grown(margin), problem.ground
    spans = np.empty((2, ground.room.shape[0]))

    def valid(state: State) -> bool:
        pose = np.array([state.getX(), state.getY(), state.getYaw()])
        return not touches(ground, outline.corners, outline.reach, pose, spans)

    return valid


def _state(space: Any, pose: NDArray[np.float64]) -> State:
    state = space.allocState()
    state.setXY(float(pose[0]), float(pose[1]))
    state.setYaw(float((pose[2] + np.pi) % (2.0 * np.pi) - np.pi))
    return state


def _with_gears(poses: NDArray[np.float64], *, slides: bool) -> NDArray[np.float64]:
    """Return poses [P, 3] with the gears that lead to them, [P, 4]."""
    legs = np.diff(poses[:, :2], axis=0)
    poses = poses[np.append(True, np.hypot(*legs.T) > 1e-6)]
    poses[:, 2] = np.unwrap(poses[:, 2])
    legs, heading = np.diff(poses[:, :2], axis=0), 0.5 * (poses[1:, 2] + poses[:-1, 2])
    ahead = legs[:, 0] * np.cos(heading) + legs[:, 1] * np.sin(heading)
    gears = np.full(len(ahead), float(SLIDING)) if slides else np.where(ahead < 0.0, -1.0, 1.0)
    return np.concatenate([poses, np.append(gears[:1], gears)[:, None]], 1)
