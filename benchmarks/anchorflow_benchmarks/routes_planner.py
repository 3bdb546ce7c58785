"""What a search reaches without a network: splines along a scene's routes, finished."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.finish import finished, refiner_of
from anchorflow_benchmarks.planners import without_fields
from anchorflow_service.bundle.manifest import SplineEntry
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.route_shortening import pulled_tight
from anchorflow_trajectory.route_splines import splines_along, spread_round
from anchorflow_trajectory.routes import Route, find_routes, polyline_length
from anchorflow_trajectory.scene import Scene

DESCENTS = (0, 5, 10, 20, 60)


@dataclass(frozen=True)
class RoutesPlanner:
    """The routes' splines, a smooth spread round each, and so many descents of a bundle's finish.

    Where no way is free, the straight line stands for one.
    """

    limits: MotionLimits
    finish: SplineEntry
    descents: int
    evaluations: None = None

    @property
    def name(self) -> str:
        return f"routes + finish, {self.descents} descents"

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        scene = without_fields(scene)
        refiner = refiner_of(self.finish, self.limits, steps=self.descents)
        basis, routes = refiner.basis, scene_routes(scene) or [straight(scene)]
        splines = splines_along(routes, basis, x_curr=scene.x_curr, x_goal=scene.x_goal)
        rng = np.random.default_rng(seed)
        tries = spread_round(splines, basis, tries=num, rng=rng)
        states = np.concatenate(basis.states(tries.control), axis=-1, dtype=np.float32)
        return finished(states, scene, refiner, self.finish)


def scene_routes(scene: Scene) -> list[Route]:
    """A scene's routes, pulled tight."""
    field, map_frame = scene.clearance_field, (scene.resolution, scene.origin)
    resolution, origin = map_frame
    start, goal = scene.x_curr[:2], scene.x_goal[:2]
    routes = find_routes(field, resolution=resolution, origin=origin, start=start, goal=goal)
    return pulled_tight(routes, field, resolution=resolution, origin=origin)


def straight(scene: Scene) -> Route:
    """From start to goal, whatever stands between."""
    points = np.stack([scene.x_curr[:2], scene.x_goal[:2]]).astype(np.float64)
    return Route(points, polyline_length(points), ())
