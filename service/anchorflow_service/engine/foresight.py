"""The choice of cars that are told who else is there: scores by where the others may go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from anchorflow_client.contract.batch import FUTURE_PROBABILITIES, FUTURES
from anchorflow_client.sensors import HEADING, KIND, LENGTH, OTHERS_TIMES_S, VX, WIDTH
from anchorflow_service.bundle.entries import STATUS, GuardEntry
from anchorflow_service.bundle.manifest import OTHERS, Manifest
from anchorflow_service.engine.along_route import route_of
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
from anchorflow_trajectory.car.by_rule import BRAKES_HARD, HARD_CHANCE, arcs
from anchorflow_trajectory.car.careful import (
    careful_drives,
    presumed_course,
    reference_progress,
)
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.foresight import (
    Driven,
    Foreseen,
    foreseen_poses,
    standing_places,
)
from anchorflow_trajectory.car.tracking import PLAN_TIMES, EgoState, wrap_angle
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

WHEELBASE = 0.5968
"""In lengths, as `anchorflow_driving.window` has it."""
PERSON = 2
"""A kind of `others`, who may turn on the spot."""
SECOND_AGO = OTHERS_TIMES_S.index(-1.0)
Scorer = Callable[[Array], Array]
"""Scores [K] of states [K,T,S] that the sampler did not draw."""


@dataclass(frozen=True, eq=False)
class _Told:
    """The A others of a request.

    now: [A,3]; velocity: [A,2]; turn_rate: [A] rad/s; half: [A,2]; delay_s: of the plan
    """

    there: Array
    now: Array
    velocity: Array
    turn_rate: Array
    half: Array
    delay_s: float

    @classmethod
    def by(cls, scene: ConditionedScene) -> _Told:
        others = scene.inputs((OTHERS,))[OTHERS][0].astype(np.float64)
        there = others[:, -1, KIND] > 0
        others = others[there]
        now, before = others[:, -1], others[:, SECOND_AGO]
        turn = wrap_angle(now[:, HEADING] - before[:, HEADING]) / -OTHERS_TIMES_S[SECOND_AGO]
        return cls(
            there=there,
            now=now[:, : HEADING + 1],
            velocity=now[:, VX:LENGTH],
            turn_rate=np.where((before[:, KIND] > 0) & (now[:, KIND] != PERSON), turn, 0.0),
            half=now[:, LENGTH : WIDTH + 1] / 2,
            delay_s=scene.request.delay_s,
        )

    def foreseen(self, futures: Array, chances: Array, standing: Array) -> Foreseen:
        """Return them in modes [A,M,8,3] with chances [A,M], or [M] that all have."""
        poses = foreseen_poses(self.now, futures, from_s=self.delay_s)
        return Foreseen(poses, np.broadcast_to(chances, poses.shape[:2]), self.half, standing)

    def steady(self, standing: Array) -> Foreseen:
        """Return them at their present velocities."""
        futures = np.repeat(self.now[:, None], len(PLAN_TIMES), 1)
        futures[..., :2] += PLAN_TIMES[:, None] * self.velocity[:, None]
        return self.foreseen(futures[:, None], np.ones(1), standing)

    def braking(self, rate: float) -> Array:
        """Return their futures [A,1,8,3] along their arcs, braking by a rate (m/s²)."""
        return arcs(self.now, self.velocity, self.turn_rate, braking=rate)[:, None]


class Foresight:
    """Scores trajectories by what they are worth among the `others` of a request.

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
        told, car, start = _Told.by(scene), *self._car(scene)
        foreseen, seen = self._foreseen(told, samples, futures)
        states, own = samples.states, samples.arrays[SCORES]
        count, most = len(states), max(len(states) // 4, 1)
        course = _course(self._answered(states, scene), own, scene, start)
        careful = [careful_drives(course, start, car, each) for each in (seen, foreseen)]
        added = self._from_now(np.concatenate(careful), scene, states)
        states = np.concatenate([states, added])
        road = raster_of(self._entry.road, samples.context)
        driven = _driven(self._answered(states, scene), start, car, road, course)
        reference = reference_progress(driven[count : count + len(careful[0])], seen)
        worth = driven.among(foreseen).worth(reference=reference).astype(own.dtype)
        scores = own * worth[:count]
        if scorer is None:
            return replace(samples, arrays={**samples.arrays, SCORES: scores})
        taken = best(worth[count:], most)
        return self._replaced(
            samples, scores, added[taken], scorer(added[taken]) * worth[count:][taken]
        )

    def _replaced(self, samples: Samples, scores: Array, states: Array, others: Array) -> Samples:
        """Return samples with scores [N], of which the worst make way for better states [K,T,S]
        with scores [K]."""
        order, worst = best(others, len(others)), best(-scores, len(others))
        better = others[order] > scores[worst]
        order, worst = order[better], worst[better]
        arrays = dict(samples.arrays)
        for name in self._of_each & set(arrays):
            arrays[name] = arrays[name].copy()
            arrays[name][worst] = 0
        kept = samples.states.copy()
        kept[worst], scores[worst] = states[order], others[order]
        return replace(samples, states=kept, arrays=arrays | {SCORES: scores})

    def _car(self, scene: ConditionedScene) -> tuple[Car, EgoState]:
        return car_of(self._entry, scene), _state(scene)

    def _answered(self, states: Array, scene: ConditionedScene) -> Array:
        return self._late.answered(states[..., :POSE], scene).astype(np.float64)

    def _from_now(self, drives: Array, scene: ConditionedScene, like: Array) -> Array:
        """Return drives [K,8,3] after the departure as states at the times of poses from now on."""
        states = np.zeros((len(drives), *like.shape[1:]), like.dtype)
        departure = departure_of(scene)
        if departure is not None:
            first = np.broadcast_to(departure.pose, (len(drives), 1, POSE))
            knots = np.concatenate([[0.0], departure.time + np.concatenate([[0.0], PLAN_TIMES])])
            poses = np.concatenate([0 * first, first, drives], 1)
            poses[..., 2] = np.unwrap(poses[..., 2], axis=1)
            ways = [[np.interp(PLAN_TIMES, knots, axis) for axis in each.T] for each in poses]
            drives = np.array(ways).swapaxes(1, 2)
        states[..., :POSE] = drives
        return states

    def _foreseen(
        self, told: _Told, samples: Samples, futures: Arrays
    ) -> tuple[Foreseen, Foreseen]:
        """Return the others as foreseen, any of whom may brake hard, and at their velocities."""
        assert self._entry.occupied is not None
        occupied = raster_of(self._entry.occupied, samples.context)
        standing = standing_places(occupied, told.now, told.half)
        modes = [futures[FUTURES][told.there], told.braking(BRAKES_HARD)]
        chances = (1 - HARD_CHANCE) * futures[FUTURE_PROBABILITIES][told.there].astype(np.float64)
        hard = np.full((len(chances), 1), HARD_CHANCE)
        foreseen = told.foreseen(
            np.concatenate(modes, 1, dtype=np.float64), np.concatenate([chances, hard], 1), standing
        )
        return foreseen, told.steady(standing)


def _driven(plans: Array, start: EgoState, car: Car, road: Raster, course: Course) -> Driven:
    wheelbase = 2 * WHEELBASE * car.half_length
    return Driven.of(plans, start, car, road, wheelbase=wheelbase, course=course)


def _course(plans: Array, likely: Array, scene: ConditionedScene, start: EgoState) -> Course:
    """Return the route of a request; without one, where plans [N,8,3] go that are likely [N]."""
    route = route_of(scene)
    return presumed_course(plans, likely, start) if route is None else Course(route)


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
