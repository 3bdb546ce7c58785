"""Late plans of cars: the trajectories of a request with a delay, joined to where they begin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_service.bundle.entries import STATUS
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.interfaces import Array, ConditionedScene
from anchorflow_trajectory.late import Departure, joined

SPEED, ACCELERATION, ASIDE = 4, 6, 7
"""Indices in `ego_status` of the velocity along x and of the accelerations along x and y."""
SLOWEST_TURN = 1.0
"""m/s; below it a yaw rate cannot be read from an acceleration."""
POSE = 3


def speed_of(scene: ConditionedScene) -> float:
    """Return the m/s of a scene's car."""
    return float(scene.inputs((STATUS,))[STATUS][0, SPEED])


def yaw_rate_of(scene: ConditionedScene) -> float:
    """Return the rad/s of a scene's car; 0 if it is slow."""
    speed, aside = speed_of(scene), float(scene.inputs((STATUS,))[STATUS][0, ASIDE])
    return aside / speed if speed > SLOWEST_TURN else 0.0


def departure_of(scene: ConditionedScene) -> Departure | None:
    """Return where the plans of a request with a delay begin; None without one."""
    request = scene.request
    if not request.delay_s:
        return None
    speed = speed_of(scene)
    if request.last_plan is not None:
        return Departure.along(request.delay_s, request.last_plan, speed=speed)
    yaw_rate = yaw_rate_of(scene)
    return Departure.at_constant_rates(request.delay_s, speed=speed, yaw_rate=yaw_rate)


class LatePlans:
    """Joins the trajectories of requests with a delay; those of others stay as they are."""

    def __init__(self, manifest: Manifest) -> None:
        steps = np.arange(manifest.time.steps, dtype=np.float64)
        self.times: NDArray[np.float64] = np.asarray(
            manifest.time.first_s + (manifest.time.dt or 0.0) * steps
        )

    def answered(self, plans: Array, scene: ConditionedScene) -> Array:
        """Return plans [N,T,3] at their times after the departure."""
        return self._joined(plans, scene, since_departure=True)

    def as_driven(self, states: Array, scene: ConditionedScene) -> Array:
        """Return states [N,T,S], poses first, with the poses at their times from now, for a score.

        Those before the departure are the departure's.
        """
        return self._joined(states, scene, since_departure=False)

    def _joined(self, states: Array, scene: ConditionedScene, *, since_departure: bool) -> Array:
        departure = departure_of(scene)
        if departure is None:
            return states
        at = self.times if since_departure else np.maximum(self.times - departure.time, 0.0)
        plans, late = states[..., :POSE].astype(np.float64), states.copy()
        speed = speed_of(scene)
        late[..., :POSE] = joined(plans, self.times, speed=speed, departure=departure, at=at)
        return late
