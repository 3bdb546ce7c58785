"""Which of a scene's routes its successful anchors take.

The routes are those of a file, or are searched by `anchorflow_trajectory.routes` to the last one
within its limits, on the judge's own distances. Either way they are known before any planner is
asked, and no planner's tries have a part in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.ray_signature import ObstacleRays, Signature
from anchorflow_trajectory.routes import find_routes
from anchorflow_trajectory.scene import Scene

Array = NDArray[np.float64]

# What counts as a scene's routes; a planner may look for more of them.
MOST, STRETCH, SLACK = 8, 1.25, 0.03
DISTINCT = 0.1  # m rms from which two anchors differ
ROUTE_MEASURES = ("recall", "first", "found", "distinct")


@dataclass(frozen=True, eq=False)
class RouteJudge:
    """Judges the successes of one scene.

    room: [H, W] m beyond robot_radius at cell centres, by the judge's distances
    given: the routes' signatures, the shortest first; None to search for them
    """

    scene: Scene
    room: Array
    given: Sequence[Signature] | None = None

    @cached_property
    def listed(self) -> Sequence[Signature]:
        """The routes' signatures, the shortest first."""
        if self.given is not None:
            return self.given
        scene = self.scene
        routes = find_routes(
            self.room,
            resolution=scene.resolution,
            origin=scene.origin,
            start=scene.x_curr[:2].astype(float),
            goal=scene.x_goal[:2].astype(float),
            most=MOST,
            stretch=STRETCH,
            slack=SLACK,
        )
        return [route.signature for route in routes]

    @cached_property
    def _rays(self) -> ObstacleRays:
        return ObstacleRays.of(self.room)

    def measures(self, successes: Array) -> dict[str, float]:
        """By the names of ROUTE_MEASURES, of successes [M, T, 2]; NaN where no route is listed.

        recall     share of the routes that a success takes
        first      1 where one takes the shortest, else 0
        found      routes that successes take, listed or not
        distinct   successes left when of any two within 10 cm rms one is dropped
        """
        if not self.listed:
            return dict.fromkeys(ROUTE_MEASURES, np.nan)
        scene = self.scene
        taken = set(
            self._rays.signatures(successes, resolution=scene.resolution, origin=scene.origin)
        )
        return {
            "recall": float(np.mean([route in taken for route in self.listed])),
            "first": float(self.listed[0] in taken),
            "found": float(len(taken)),
            "distinct": float(count_distinct(successes)),
        }


def count_distinct(paths: Array) -> int:
    """Paths [M, T, 2] left when, one after the other, those near one that is kept are dropped."""
    kept = paths[:0]
    for path in paths:
        if (((kept - path) ** 2).sum(-1).mean(-1) >= DISTINCT**2).all():
            kept = np.concatenate([kept, path[None]])
    return len(kept)
