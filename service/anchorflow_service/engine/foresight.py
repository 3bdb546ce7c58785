"""The choice of cars that are told who else is there: scores by where the others may go."""

from __future__ import annotations

import numpy as np

from anchorflow_client.contract.batch import FUTURE_PROBABILITIES, FUTURES
from anchorflow_client.sensors import HEADING, KIND, LENGTH, WIDTH
from anchorflow_service.bundle.entries import STATUS, GuardEntry
from anchorflow_service.bundle.manifest import OTHERS, Manifest
from anchorflow_service.engine.guard import SCORES, car_of, raster_of
from anchorflow_service.engine.interfaces import Array, Arrays, ConditionedScene, Samples
from anchorflow_service.engine.late import (
    ACCELERATION,
    POSE,
    SLOWEST_TURN,
    LatePlans,
    departure_of,
    speed_of,
    yaw_rate_of,
)
from anchorflow_service.engine.later_loops import FORESIGHT_LOOPS
from anchorflow_trajectory.car.foresight import (
    Foreseen,
    foreseen_poses,
    standing_places,
    worth,
)
from anchorflow_trajectory.car.tracking import PLAN_TIMES, EgoState

WHEELBASE = 0.5968
"""In lengths, as `anchorflow_driving.window` has it."""


class Foresight:
    """Multiplies scores by what trajectories are worth among the others of a request.

    The first instance compiles the loops that are not on disk.
    """

    def __init__(self, manifest: Manifest) -> None:
        assert isinstance(manifest.finish, GuardEntry)
        self._entry, self._late = manifest.finish, LatePlans(manifest)
        FORESIGHT_LOOPS.load()

    @staticmethod
    def is_possible(manifest: Manifest) -> bool:
        """Return whether a bundle has futures, scores, the poses of 4 s and what a guard reads."""
        finish, time = manifest.finish, manifest.time
        times = time.first_s + (time.dt or 0.0) * np.arange(time.steps)
        return (
            isinstance(finish, GuardEntry)
            and finish.occupied is not None
            and SCORES in manifest.answer.arrays
            and np.array_equal(times, PLAN_TIMES)
        )

    def scores(self, samples: Samples, scene: ConditionedScene, futures: Arrays) -> Array:
        """Return the scores [N] of a scene whose request tells `others`.

        futures: outputs of the graph `futures`
        """
        FORESIGHT_LOOPS.require()
        plans = self._late.answered(samples.states[..., :POSE], scene).astype(np.float64)
        car, own = car_of(self._entry, scene), samples.arrays[SCORES]
        foreseen = self._foreseen(samples, scene, futures)
        wheelbase = 2 * WHEELBASE * car.half_length
        factor = worth(plans, _state(scene), car, foreseen, wheelbase=wheelbase)
        return own * factor.astype(own.dtype)

    def _foreseen(self, samples: Samples, scene: ConditionedScene, futures: Arrays) -> Foreseen:
        others = scene.inputs((OTHERS,))[OTHERS][0].astype(np.float64)
        there = others[:, -1, KIND] > 0
        now, half = others[there, -1, : HEADING + 1], others[there, -1, LENGTH : WIDTH + 1] / 2
        assert self._entry.occupied is not None
        occupied = raster_of(self._entry.occupied, samples.context)
        return Foreseen(
            poses=foreseen_poses(now, futures[FUTURES][there], from_s=scene.request.delay_s),
            probabilities=futures[FUTURE_PROBABILITIES][there].astype(np.float64),
            half=half,
            standing=standing_places(occupied, now, half),
            road=raster_of(self._entry.road, samples.context),
        )


def _state(scene: ConditionedScene) -> EgoState:
    """Return how a scene's car moves when its plan begins; until then its rates are their means."""
    speed, departure = max(speed_of(scene), 0.0), departure_of(scene)
    if departure is not None:
        pull, way = (departure.speed - speed) / departure.time, np.hypot(*departure.pose[:2])
        curvature = departure.pose[2] / way if way > SLOWEST_TURN * departure.time else 0.0
        return EgoState(departure.pose, departure.speed, pull, float(curvature))
    pull = scene.inputs((STATUS,))[STATUS][0, ACCELERATION]
    curvature = yaw_rate_of(scene) / speed if speed else 0.0
    return EgoState(np.zeros(POSE), speed, float(pull), curvature)
