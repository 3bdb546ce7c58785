"""The choice along a route: a trajectory that ends beside it, or is turned from it, loses score.

For planners whose requests may have the input `route` although no graph of theirs takes it.
"""

from __future__ import annotations

import numpy as np

from anchorflow_client.contract.batch import beside_route
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.interfaces import Array, ConditionedScene
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.tracking import wrap_angle

ROUTE = "route"
WITHIN_M = 2.0
"""m from the route at which an end is still on it: half a wide lane."""
LOSS = 0.2
"""Score that is lost with each further metre."""
TURNED = 0.6
"""Score that is lost with each radian by which the poses are turned from the route in the mean."""


class AlongRoute:
    """Scores trajectories by a request's route; without one they keep their scores."""

    def __init__(self, manifest: Manifest) -> None:
        asked = {spec.name for spec in manifest.request.inputs}
        self._reads = ROUTE in asked - {*manifest.graphs["encode"].input_names}

    def scored(self, scores: Array, trajectories: Array, scene: ConditionedScene) -> Array:
        """Return the scores [K] of trajectories [K,T,D] along the route."""
        if not self._reads:
            return scores
        route = route_of(scene)
        if route is None:
            return scores
        beside = np.maximum(beside_route(trajectories[:, -1, :2], route) - WITHIN_M, 0.0)
        turned = turned_from(trajectories, Course(route)).mean(-1)
        return (scores - LOSS * beside - TURNED * turned).astype(scores.dtype)


def turned_from(poses: Array, course: Course) -> Array:
    """Return the rad by which poses [...,3] are turned from a course at its nearest points."""
    return np.abs(wrap_angle(poses[..., 2] - course.heading[course.nearest(poses[..., :2])]))


def route_of(scene: ConditionedScene) -> Array | None:
    """Return the route [P,2] of a scene; None if it is not told, or all points are one."""
    if ROUTE not in scene.request.inputs:
        return None
    (route,) = scene.inputs((ROUTE,))[ROUTE]
    return route if np.ptp(route, axis=0).any() else None
