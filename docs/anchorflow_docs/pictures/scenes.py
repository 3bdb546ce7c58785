"""Draw scenes from the project's generator, and plan anchors on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch, AnchorRequest, CostMap, resolve_for_card
from anchorflow_service.engine import Engine
from anchorflow_service.engine.samplers.ode import FlowStates
from anchorflow_training.data.inspection import homology_classes, obstacle_points
from anchorflow_training.scenes import FamilyScene, RobotRanges, SceneError, draw_scene
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene

FAMILIES = ("rooms", "posts", "maze", "bug_traps", "city", "gaps", "discs", "forest")
QUICK = {"method": "midpoint", "schedule": {"uniform": 2}}
"""A fast sampler for the search through many scenes."""
MIN_ANCHORS = 5  # of a way; fewer are not visible
MIN_DISTANCE = 5.0  # m between start and goal
MAX_RESOLUTION = 0.14  # m/cell; in larger scenes a robot is a dot
ONE_ROBOT = RobotRanges(usual=1.0, fixed=0.0)  # the card's, without a horizon

Wanted = Callable[[FamilyScene], bool]


def anything(_: FamilyScene) -> bool:
    """Accept every scene."""
    return True


@dataclass(frozen=True)
class Stage:
    """An engine, and the seed of its scenes."""

    engine: Engine
    seed: int

    def scene(self, family: str, wanted: Wanted = anything) -> FamilyScene:
        """Return the seed's first scene of a family that is large enough and `wanted`."""
        for scene in self._scenes(family):
            far = np.linalg.norm(scene.x_goal[:2] - scene.x_curr[:2]) > MIN_DISTANCE
            fine = scene.resolution < MAX_RESOLUTION
            if scene.family == family and far and fine and wanted(scene):
                return scene
        raise AssertionError("scenes never end")

    def scene_with_ways(self, family: str, least: int, wanted: Wanted = anything) -> FamilyScene:
        """Return the first scene with safe anchors that take at least `least` ways."""

        def takes_them(scene: FamilyScene) -> bool:
            if not wanted(scene):
                return False
            answer = self.plan(scene, sampler=QUICK)
            taken = np.bincount(ways(scene, answer)) >= MIN_ANCHORS
            return bool(answer.safe.all() and taken.sum() >= least)

        return self.scene(family, takes_them)

    def request(self, scene: Scene, **optional: Any) -> AnchorRequest:
        """Build the request of a scene, by default in its own style."""
        fields = {"w_style": scene.w_style, "seed": 0} | optional
        return AnchorRequest.build(
            cost_map=CostMap.build(scene.cost_map, scene.resolution, scene.origin),
            x_curr=scene.x_curr,
            x_goal=scene.x_goal,
            robot_radius=scene.robot_radius,
            **fields,
        )

    def plan(self, scene: Scene, **optional: Any) -> AnchorBatch:
        return self.engine.plan(resolve_for_card(self.request(scene, **optional), self.engine.card))

    def flow_states(self, scene: Scene, **optional: Any) -> FlowStates:
        """Return the states of the flow on the way to the answer."""
        request = self.request(scene, **optional)
        return self.engine.flow_states(resolve_for_card(request, self.engine.card))

    def _scenes(self, family: str) -> Iterator[FamilyScene]:
        card = self.engine.card
        rng = np.random.default_rng([self.seed, FAMILIES.index(family)])
        own = card.cost_map.limits
        limits = MotionLimits(own.v_max, own.a_max, own.horizon_s)
        while True:
            with suppress(SceneError):
                yield draw_scene(rng, limits=limits, robots=ONE_ROBOT)


def ways(scene: Scene, answer: AnchorBatch) -> NDArray[np.int64]:
    """Return the homology class [N] of each anchor; 0 is the most frequent."""
    points = obstacle_points(scene.clearance_field, scene.resolution, scene.origin)
    classes = homology_classes(answer.trajectories, points)
    rank_of = np.argsort(np.argsort(-np.bincount(classes), kind="stable"))
    return rank_of[classes]
