"""What a search reaches without a network: splines along a scene's routes, finished."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.finish import finished, unfinished_scene, with_descents
from anchorflow_service.bundle.manifest import SplineEntry
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.route_splines import STRETCH, spread_round, usual_spread
from anchorflow_trajectory.scene import Scene

DESCENTS = (0, 5, 10, 20, 60)


@dataclass(frozen=True)
class RoutesPlanner:
    """The routes' splines, a smooth spread round each, and so many descents of a bundle's finish.

    What its flow begins with and what it ends with, without the flow: each lasts as long as its
    route and style make it, or as the horizon of the limits. Where no way is free, the smoothest
    curve stands for one.
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
        tried = spread_round(
            scene.route_splines,
            scene.basis,
            tries=num,
            rng=np.random.default_rng(seed),
            spread=usual_spread(scene.ends),
            stretch=STRETCH if self.limits.horizon_s is None else 0.0,
        )
        finish = with_descents(self.finish, self.descents)
        return finished(tried.splines, tried.route, scene, finish)
