"""The choice of cars that are told who else is there: scores by where the others may go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from anchorflow_client.contract.batch import FUTURE_PROBABILITIES, FUTURES
from anchorflow_client.sensors import HEADING, KIND, LENGTH, VX, WIDTH
from anchorflow_service.bundle.entries import STATUS, GuardEntry
from anchorflow_service.bundle.manifest import OTHERS, Manifest
from anchorflow_service.engine.guard import SCORES, car_of, raster_of
from anchorflow_service.engine.interfaces import (
    Array,
    Arrays,
    ConditionedScene,
    Samples,
    best,
    names_of_each,
)
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
from anchorflow_service.engine.samplers.along_route import ROUTE
from anchorflow_trajectory.car.careful import (
    careful_drives,
    presumed_course,
    reference_progress,
)
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.foresight import (
    Foreseen,
    foreseen_poses,
    standing_places,
    worth,
)
from anchorflow_trajectory.car.tracking import PLAN_TIMES, EgoState

VELOCITY = slice(VX, LENGTH)
"""Indices in a row of `others`."""
WHEELBASE = 0.5968
"""In lengths, as `anchorflow_driving.window` has it."""


Scorer = Callable[[Array], Array]
"""Scores [K] of states [K,T,S] that the sampler did not draw."""


class Foresight:
    """Scores trajectories by what they are worth among the others of a request, and adds careful
    drives to them.

    The first instance compiles the loops that are not on disk.
    """

    def __init__(self, manifest: Manifest) -> None:
        assert isinstance(manifest.finish, GuardEntry)
        self._entry, self._late = manifest.finish, LatePlans(manifest)
        self._of_each = names_of_each(manifest.sampled_extras)
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

    def chosen(
        self, samples: Samples, scene: ConditionedScene, futures: Arrays, scorer: Scorer | None
    ) -> Samples:
        """Return the samples with their scores among the `others` of a request.

        Careful drives take the places of worse samples, of a quarter at most; extras of theirs are
        0.

        futures: outputs of the graph `futures`
        scorer: of careful drives; None: there are none
        """
        FORESIGHT_LOOPS.require()
        car, start = car_of(self._entry, scene), _state(scene)
        wheelbase = 2 * WHEELBASE * car.half_length
        foreseen, seen = self._foreseen(samples, scene, futures)
        states, own = samples.states, samples.arrays[SCORES]
        course = self._course(states, own, scene, start)
        drives = careful_drives(course, start, car, seen, foreseen)
        reference = reference_progress(
            drives[: len(drives) // 2], course, start, car, seen, wheelbase=wheelbase
        )
        if scorer is not None:
            added = self._from_now(drives, scene, states)
            states = np.concatenate([states, added])
            own = np.concatenate([own, scorer(added)])
        plans = self._answered(states, scene)
        factor = worth(
            plans,
            start,
            car,
            foreseen,
            wheelbase=wheelbase,
            course=course,
            reference=reference,
        )
        scores = own * factor.astype(own.dtype)
        return self._best_of(samples, states, scores)

    def _best_of(self, samples: Samples, states: Array, scores: Array) -> Samples:
        """Return as many as were sampled: of states [N + K,T,S] the first N, of which the worst
        quarter makes way for those of the others that are better."""
        count = len(samples.states)
        added = count + best(scores[count:], max(count // 4, 1))
        worst = best(-scores[:count], len(added))
        better = scores[added] > scores[worst]
        place = np.arange(count)
        place[worst[better]] = added[better]
        arrays = {**samples.arrays, SCORES: scores[place]}
        for name in self._of_each & set(arrays):
            arrays[name] = arrays[name].copy()
            arrays[name][worst[better]] = 0
        return replace(samples, states=states[place], arrays=arrays)

    def _answered(self, states: Array, scene: ConditionedScene) -> Array:
        return self._late.answered(states[..., :POSE], scene).astype(np.float64)

    def _course(
        self, states: Array, own: Array, scene: ConditionedScene, start: EgoState
    ) -> Course:
        """Return the route of a request; without one, where the samples go."""
        if ROUTE in scene.request.inputs:
            (route,) = scene.inputs((ROUTE,))[ROUTE].astype(np.float64)
            if np.ptp(route, axis=0).any():
                return Course(route)
        return presumed_course(self._answered(states, scene), own, start)

    def _from_now(self, drives: Array, scene: ConditionedScene, like: Array) -> Array:
        """Return drives [K,8,3] after the departure as states at the times of poses from now on."""
        states = np.zeros((len(drives), *like.shape[1:]), like.dtype)
        departure = departure_of(scene)
        if departure is not None:
            first = np.broadcast_to(departure.pose, (len(drives), 1, POSE))
            knots = np.concatenate([[0.0], departure.time + np.concatenate([[0.0], PLAN_TIMES])])
            poses = np.concatenate([0 * first, first, drives], 1)
            poses[..., 2] = np.unwrap(poses[..., 2], axis=1)
            drives = np.stack(
                [[np.interp(PLAN_TIMES, knots, axis) for axis in each.T] for each in poses]
            ).swapaxes(1, 2)
        states[..., :POSE] = drives
        return states

    def _foreseen(
        self, samples: Samples, scene: ConditionedScene, futures: Arrays
    ) -> tuple[Foreseen, Foreseen]:
        """Return the others as foreseen, and at their present velocities."""
        others = scene.inputs((OTHERS,))[OTHERS][0].astype(np.float64)
        there = others[:, -1, KIND] > 0
        now, half = others[there, -1, : HEADING + 1], others[there, -1, LENGTH : WIDTH + 1] / 2
        assert self._entry.occupied is not None
        occupied = raster_of(self._entry.occupied, samples.context)
        delay_s = scene.request.delay_s
        foreseen = Foreseen(
            poses=foreseen_poses(now, futures[FUTURES][there], from_s=delay_s),
            probabilities=futures[FUTURE_PROBABILITIES][there].astype(np.float64),
            half=half,
            standing=standing_places(occupied, now, half),
            road=raster_of(self._entry.road, samples.context),
        )
        steady = np.repeat(now[:, None, None], len(PLAN_TIMES), 2)
        steady[..., :2] += PLAN_TIMES[:, None] * others[there, -1, None, None, VELOCITY]
        poses, certain = foreseen_poses(now, steady, from_s=delay_s), np.ones((len(now), 1))
        return foreseen, replace(foreseen, poses=poses, probabilities=certain)


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
