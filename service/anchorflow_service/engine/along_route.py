"""The choice along a route: a trajectory that ends beside it loses score.

For planners whose requests may have the input `route` although no graph of theirs takes it.
"""

from __future__ import annotations

import numpy as np

from anchorflow_client.contract.batch import beside_route
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.interfaces import Array, ConditionedScene

ROUTE = "route"
WITHIN_M = 2.0
"""m from the route at which an end is still on it: half a wide lane."""
LOSS = 0.2
"""Score that is lost with each further metre."""


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
        beside = beside_route(trajectories[:, -1, :2], route)
        return (scores - LOSS * np.maximum(beside - WITHIN_M, 0.0)).astype(scores.dtype)


def route_of(scene: ConditionedScene) -> Array | None:
    """Return the route [P,2] of a scene; None if it is not told, or all points are one."""
    if ROUTE not in scene.request.inputs:
        return None
    (route,) = scene.inputs((ROUTE,))[ROUTE]
    return route if np.ptp(route, axis=0).any() else None
