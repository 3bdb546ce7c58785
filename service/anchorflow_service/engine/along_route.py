"""The choice along a route: a trajectory that ends beside it, or is turned from it, loses score.

For planners whose requests may have the input `route` although no graph of theirs takes it. Of
many, those are kept that differ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.batch import beside_route
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.interfaces import Array, ConditionedScene, Context, best
from anchorflow_service.engine.route_drives import RouteDrives
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.tracking import wrap_angle

ROUTE = "route"
WITHIN_M = 2.0
"""m from the route at which an end is still on it: half a wide lane."""
LOSS = 0.2
"""Score that is lost with each further metre."""
TURNED = 0.6
"""Score that is lost with each radian by which the poses are turned from the route in the mean."""
APART, DIFFERENT = 2.0, 4
"""m of two trajectories that differ, the root mean square over their poses, and one in how many of
those that are kept differs from all better ones."""
SHORTER, SHORT = 0.05, 5.0
"""Score in [0, 1] that a trajectory without any way loses beside the longest, or beside one of
5 m if all are shorter."""


class AlongRoute:
    """Scores trajectories by a request's route; without one they keep their scores."""

    def __init__(self, manifest: Manifest) -> None:
        asked = {spec.name for spec in manifest.request.inputs}
        self._reads = ROUTE in asked - {*manifest.graphs["encode"].input_names}
        self._drives = RouteDrives(manifest) if RouteDrives.is_possible(manifest) else None

    def scored(self, scores: Array, trajectories: Array, scene: ConditionedScene) -> Array:
        """Return the scores [K] of trajectories [K,T,D] along the route."""
        route = self._route(scene)
        if route is None:
            return scores
        beside = np.maximum(beside_route(trajectories[:, -1, :2], route) - WITHIN_M, 0.0)
        turned = turned_from(trajectories, Course(route)).mean(-1)
        return (scores - LOSS * beside - TURNED * turned).astype(scores.dtype)

    def kept(
        self, scores: Array, trajectories: Array, scene: ConditionedScene, count: int
    ) -> NDArray[np.intp]:
        """Return indices [count] of the best of trajectories [K,T,D].

        With a route the last of them are those that differ: of many variants the best are nearly
        the same, and may all be too slow.
        """
        if self._route(scene) is None:
            return best(scores, count)
        return differing(scores, trajectories[..., :2], count, alike=count - count // DIFFERENT)

    def hastened(self, scores: Array, trajectories: Array, scene: ConditionedScene) -> Array:
        """Return scores [K] in [0, 1], with a route less SHORTER by what is missing in way."""
        if self._route(scene) is None:
            return scores
        ways = np.diff(trajectories[..., :2], axis=1, prepend=0.0)
        length = np.linalg.norm(ways, axis=-1).sum(-1)
        return (scores - SHORTER * (1 - length / max(length.max(), SHORT))).astype(scores.dtype)

    def among_drives(
        self, scores: Array, trajectories: Array, scene: ConditionedScene, context: Context
    ) -> tuple[Array, Array]:
        """Return scores [K+M] of trajectories [K+M,T,D]; the last M are drives along the route, if
        the request has one and asks for drives."""
        route = self._route(scene)
        if route is None or self._drives is None or not self._drives.are_asked(scene):
            return scores, trajectories
        return self._drives.among(scores, trajectories, route, scene, context)

    def _route(self, scene: ConditionedScene) -> Array | None:
        return route_of(scene) if self._reads else None


def differing(scores: Array, ways: Array, count: int, *, alike: int) -> NDArray[np.intp]:
    """Return indices [count] of ways [K,T,2]: `alike` of the best, then each APART from all before.

    If these are too few, the best of the others follow.
    """
    order = best(scores, len(scores))
    points = ways[order].reshape(len(order), -1).astype(np.float64)
    square, free = (points * points).sum(1), np.ones(len(order), np.bool_)
    chosen: list[int] = []
    for _ in range(min(count, len(order))):
        if len(chosen) >= alike and not free.any():
            break
        one = len(chosen) if len(chosen) < alike else int(free.argmax())
        apart = (square + square[one] - 2 * points @ points[one]) / ways.shape[1]
        free &= apart > APART**2
        free[one] = False
        chosen.append(one)
    others = np.delete(np.arange(len(order)), chosen)[: count - len(chosen)]
    return order[np.concatenate([np.array(chosen, np.intp), others])]


def turned_from(poses: Array, course: Course) -> Array:
    """Return the rad by which poses [...,3] are turned from a course at its nearest points."""
    return np.abs(wrap_angle(poses[..., 2] - course.heading[course.nearest(poses[..., :2])]))


def route_of(scene: ConditionedScene) -> Array | None:
    """Return the route [P,2] of a scene; None if it is not told, or all points are one."""
    if ROUTE not in scene.request.inputs:
        return None
    (route,) = scene.inputs((ROUTE,))[ROUTE]
    return route if np.ptp(route, axis=0).any() else None
