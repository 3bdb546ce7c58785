"""The finish of planners for cars: judges trajectories by what the planner perceives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import GuardSpec
from anchorflow_service.bundle.entries import VEHICLE_SIZE, AgentsEntry, GuardEntry, RasterEntry
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.interfaces import (
    SAFE,
    Array,
    Arrays,
    ConditionedScene,
    Context,
    Samples,
    names_of_each,
)
from anchorflow_service.engine.late import LatePlans, departure_of, speed_of
from anchorflow_service.engine.later_loops import GUARD_LOOPS
from anchorflow_trajectory.guard.faults import Perceived, Raster
from anchorflow_trajectory.guard.guard import Guard, Verdict, told
from anchorflow_trajectory.guard.motion import Car
from anchorflow_trajectory.guard.raster_boxes import boxes_in
from anchorflow_trajectory.guard.speeds import boxes_of

TRAJECTORIES, SCORES = "trajectories", "scores"
CAUSES, TIMES = "causes", "fault_times"
"""Arrays of a verdict between `finish` and `reason`; no answer holds them."""
AXLE = 0.2177
"""Lengths from a car's rear to its rear axle, as `anchorflow_driving.window` has it."""
APART = 1.0
"""Between the scores of the safe, of the stop and of the others."""


class GuardFinish:
    """Answers the samples as they are; if the request asks for it, judged and with a stop.

    The first instance compiles the loops that are not on disk.
    """

    def __init__(self, manifest: Manifest, *, threads: int) -> None:  # noqa: ARG002 - a Finish's
        assert isinstance(manifest.finish, GuardEntry)
        self._entry, self._late, self._D = manifest.finish, LatePlans(manifest), manifest.D
        self._of_each = names_of_each(manifest.answer.extras) | {SCORES}
        GUARD_LOOPS.load()

    def finish(self, samples: Samples, scene: ConditionedScene, *, threads: int) -> Arrays:  # noqa: ARG002
        """Return trajectories [N,T,D] and the sampler's arrays, and SAFE [N] if it is asked for."""
        plans = self._late.answered(samples.states[..., : self._D], scene)
        arrays = {TRAJECTORIES: plans, **samples.arrays}
        spec = scene.request.refine
        if not (isinstance(spec, GuardSpec) and spec.guard):
            return arrays
        GUARD_LOOPS.require()
        return self._guarded(arrays, self._guard(samples.context, scene))

    def reason(self, arrays: Arrays, scene: ConditionedScene) -> str | None:  # noqa: ARG002
        if SAFE not in arrays or arrays[SAFE].any():
            return None
        return told(Verdict(arrays[CAUSES], arrays[TIMES]))

    def _guard(self, context: Context, scene: ConditionedScene) -> Guard:
        entry = self._entry
        return Guard(
            times=self._late.times,
            car=car_of(entry, scene),
            speed=speed_of(scene),
            perceived=perceived(entry, context),
            horizon_s=entry.horizon_s,
            departure=departure_of(scene),
        )

    def _guarded(self, arrays: Arrays, guard: Guard) -> Arrays:
        """Judge the trajectories; put a stop in the place of the worst of several, or of one that
        is not safe."""
        plans = arrays[TRAJECTORIES].astype(np.float64)
        scores = arrays.get(SCORES, -np.arange(len(plans)))
        verdict, stop, of_stop = guard.with_stop(plans[np.argsort(-scores, kind="stable")])
        order = np.argsort(np.argsort(-scores, kind="stable"), kind="stable")
        verdict = verdict.of(order)
        if len(plans) == 1 and verdict.safe[0]:
            return arrays | _judged(verdict)
        worst = np.lexsort((-scores, ~verdict.safe))[-1]
        kept = np.delete(np.arange(len(plans)), worst)
        stop = stop.astype(arrays[TRAJECTORIES].dtype)
        answer = arrays | {TRAJECTORIES: np.concatenate([arrays[TRAJECTORIES][kept], stop])}
        for name in self._of_each & set(arrays):
            own = arrays[name][kept]
            answer[name] = np.concatenate([own, np.zeros_like(arrays[name][:1])])
        safe = verdict.safe[kept]
        if SCORES in arrays:
            answer[SCORES] = ranked(arrays[SCORES][kept], safe)
        return answer | _judged(
            Verdict(
                np.concatenate([verdict.cause[kept], of_stop.cause]),
                np.concatenate([verdict.time[kept], of_stop.time]),
            )
        )


def car_of(entry: GuardEntry, scene: ConditionedScene) -> Car:
    length, width = entry.size or scene.inputs((VEHICLE_SIZE,))[VEHICLE_SIZE][0].tolist()
    return Car(front=(1 - AXLE) * length, rear=AXLE * length, side=width / 2)


def ranked(scores: Array, safe: NDArray[np.bool_]) -> Array:
    """Return [N + 1] scores, the last of which is a stop's.

    Those of the safe stay. The stop's is APART below the least of them, or above all if none is
    safe; the others are lowered by as much as puts the best of them APART below the stop.
    """
    if not len(scores):
        return np.zeros(1, scores.dtype)
    stop = scores[safe].min() - APART if safe.any() else scores.max() + APART
    over = 0.0 if safe.all() else max(scores[~safe].max() - (stop - APART), 0.0)
    return np.append(np.where(safe, scores, scores - over), stop).astype(scores.dtype)


def perceived(entry: GuardEntry, context: Context) -> Perceived:
    """Read what a planner perceives from what it encoded."""
    road = raster_of(entry.road, context)
    occupied = None if entry.occupied is None else raster_of(entry.occupied, context)
    if entry.agents is None:
        assert occupied is not None  # as the manifest's check says
        return Perceived(road, *boxes_in(occupied))
    boxes = boxes_of(agents_of(entry.agents, context), occupied)
    nobody = replace(road, values=np.zeros_like(road.values))
    return Perceived(road, boxes, occupied or nobody)


def raster_of(entry: RasterEntry, context: Context) -> Raster:
    """Return a raster of the first scene."""
    values = np.asarray(context[entry.tensor])[0]
    if values.shape[-1] == 1:
        values = values[None, ..., 0]
    if entry.complement_of is not None:
        values = 1 - values[entry.complement_of][None]
    return Raster(values, entry.extent, entry.first_s, entry.step_s)


def agents_of(entry: AgentsEntry, context: Mapping[str, Array]) -> NDArray[np.float64]:
    """Return the boxes [K,5] of the first scene that count."""
    counts = np.asarray(context[entry.scores])[0] >= entry.least
    return np.asarray(context[entry.boxes], np.float64)[0, counts]


def _judged(verdict: Verdict) -> Arrays:
    return {SAFE: verdict.safe, CAUSES: verdict.cause, TIMES: verdict.time}
