"""Scenes to draw, from the project's own generator, and anchors on them."""

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
"""A sampler to look through many scenes with."""
SEVERAL = 5
"""Anchors; fewer do not show on a picture."""
FARTHEST = 5.0
"""m that start and goal are apart at least: a short way shows little."""
FINEST = 0.14
"""m/cell at most: in a larger scene a robot is a dot."""

ONE_ROBOT = RobotRanges(usual=1.0, fixed=0.0)
"""The card's own, and no horizon."""

Wanted = Callable[[FamilyScene], bool]


def anything(_: FamilyScene) -> bool:
    """Every scene will do."""
    return True


@dataclass(frozen=True)
class Stage:
    """An engine, and the seed that its scenes and noise are drawn from."""

    engine: Engine
    seed: int

    def scene(self, family: str, wanted: Wanted = anything) -> FamilyScene:
        """The seed's first scene of a family that spans some metres and is `wanted`."""
        for scene in self._scenes(family):
            far = np.linalg.norm(scene.x_goal[:2] - scene.x_curr[:2]) > FARTHEST
            if scene.family == family and far and scene.resolution < FINEST and wanted(scene):
                return scene
        raise AssertionError("scenes never end")

    def scene_with_ways(self, family: str, least: int, wanted: Wanted = anything) -> FamilyScene:
        """The first whose anchors are safe, and several of which take each of so many ways."""

        def takes_them(scene: FamilyScene) -> bool:
            if not wanted(scene):
                return False
            answer = self.plan(scene, sampler=QUICK)
            taken = np.bincount(ways(scene, answer)) >= SEVERAL
            return bool(answer.safe.all() and taken.sum() >= least)

        return self.scene(family, takes_them)

    def request(self, scene: Scene, **optional: Any) -> AnchorRequest:
        """What would be asked on a scene; the scene's own style unless told."""
        fields = {"w_style": scene.w_style, "seed": 0} | optional
        return AnchorRequest.build(
            cost_map=CostMap.build(scene.cost_map, scene.resolution, scene.origin),
            x_curr=scene.x_curr,
            x_goal=scene.x_goal,
            robot_radius=scene.robot_radius,
            **fields,
        )

    def plan(self, scene: Scene, **optional: Any) -> AnchorBatch:
        """The answer."""
        return self.engine.plan(resolve_for_card(self.request(scene, **optional), self.engine.card))

    def flow_states(self, scene: Scene, **optional: Any) -> FlowStates:
        """The states on the way to that answer."""
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
    """The homology class of each anchor [N], from 0 up, the most taken first."""
    points = obstacle_points(scene.clearance_field, scene.resolution, scene.origin)
    classes = homology_classes(answer.trajectories, points)
    rank_of = np.argsort(np.argsort(-np.bincount(classes), kind="stable"))
    return rank_of[classes]
