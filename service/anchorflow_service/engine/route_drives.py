"""Drives along a request's route, for cars that see by sensors: before the planner's trajectories,
and ordered by what it perceives."""

from __future__ import annotations

import numpy as np

from anchorflow_client.contract import GuardSpec
from anchorflow_service.bundle.entries import STATUS, GuardEntry
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.guard import car_of, raster_of
from anchorflow_service.engine.interfaces import Array, ConditionedScene, Context
from anchorflow_service.engine.late import ACCELERATION, speed_of, yaw_rate_of
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.outlook import Sight, worth
from anchorflow_trajectory.car.route_drives import route_drives
from anchorflow_trajectory.car.small_things import SmallThings
from anchorflow_trajectory.car.tracking import PLAN_TIMES, EgoState, interpolate, track
from anchorflow_trajectory.guard.faults import Raster

LIDAR, LIDAR_BEFORE = "lidar", "lidar_before"
LIDAR_EXTENT = (-32.0, 32.0, -32.0, 32.0)
WHEELBASE = 0.5968
"""In lengths, as `anchorflow_driving.window` has it."""
SLOWEST, FASTEST = 8.0, 15.0
"""m/s between which the top speed is."""
SHORTEST = 3.0
"""m of the best trajectory, up to which it is no path to brake on."""
SHARPEST = 0.25
"""1/m."""


class RouteDrives:
    """Adds drives along a route to trajectories, and scores the drives by what they meet."""

    def __init__(self, manifest: Manifest) -> None:
        assert isinstance(manifest.finish, GuardEntry)
        self._entry = manifest.finish

    @staticmethod
    def are_asked(scene: ConditionedScene) -> bool:
        """Return whether a request has drives along its route."""
        spec = scene.request.refine
        return isinstance(spec, GuardSpec) and bool(spec.route_drives)

    @staticmethod
    def is_possible(manifest: Manifest) -> bool:
        """Return whether a bundle plans 4 s and perceives road, LiDAR and predicted occupancy."""
        finish, time = manifest.finish, manifest.time
        times = time.first_s + (time.dt or 0.0) * np.arange(time.steps)
        return (
            isinstance(finish, GuardEntry)
            and finish.route_drives is not None
            and finish.occupied is not None
            and LIDAR in {spec.name for spec in manifest.request.inputs}
            and np.array_equal(times, PLAN_TIMES)
        )

    def among(
        self,
        scores: Array,
        trajectories: Array,
        route: Array,
        scene: ConditionedScene,
        context: Context,
    ) -> tuple[Array, Array]:
        """Return scores [K + M] and trajectories [K + M,T,3], the last M of which are drives.

        A drive has the best score of the trajectories, and the logarithm of how often it is worth
        the worst drive.
        """
        course, speed = Course(route), max(speed_of(scene), 0.0)
        drives = self._drives(scores, trajectories.astype(np.float64), course, speed)
        value = self._worth(drives, course, speed, scene, context)
        known = np.concatenate([scores, scores.max() + np.log(value / value.min())])
        plans = np.concatenate([trajectories, drives])
        return known.astype(scores.dtype), plans.astype(trajectories.dtype)

    def _drives(self, scores: Array, plans: Array, course: Course, speed: float) -> Array:
        """Return drives [M,8,3]: along the route, braking along the best plan, and standing."""
        own = np.concatenate([np.zeros((1, 2)), plans[scores.argmax(), :, :2]])
        last = np.linalg.norm(own[-1] - own[-2]) / PLAN_TIMES[0]
        top_speed = float(np.clip(last, SLOWEST, FASTEST))
        drives = [route_drives(course, speed, top_speed=top_speed)]
        if np.linalg.norm(np.diff(own, axis=0), axis=1).sum() > SHORTEST:
            path = Course(own)
            drives.append(route_drives(path, speed, top_speed=top_speed, offsets=(0.0,)))
        return np.concatenate([*drives, np.zeros((1, *plans.shape[1:]))])

    def _worth(
        self, plans: Array, course: Course, speed: float, scene: ConditionedScene, context: Context
    ) -> Array:
        car, entry = car_of(self._entry, scene), self._entry
        assert entry.occupied is not None
        pull = scene.inputs((STATUS,))[STATUS][0, ACCELERATION]
        curvature = yaw_rate_of(scene) / speed if speed else 0.0
        curvature = float(np.clip(curvature, -SHARPEST, SHARPEST))
        start = EgoState(np.zeros(3), speed, float(pull), curvature)
        poses = np.concatenate([np.zeros((len(plans), 1, 3)), plans], 1, dtype=np.float64)
        motion = track(interpolate(poses), start, wheelbase=2 * WHEELBASE * car.half_length)
        taken = raster_of(entry.occupied, context)
        now, before = _sweep(scene, LIDAR), None
        if LIDAR_BEFORE in scene.request.inputs:
            before = _sweep(scene, LIDAR_BEFORE)
        things = SmallThings.seen(now, before, taken, car)
        return worth(motion, car, Sight(taken, raster_of(entry.road, context), things), course)


def _sweep(scene: ConditionedScene, name: str) -> Raster:
    """Return a sweep; its rows and columns go by growing x and y."""
    return Raster(scene.inputs((name,))[name][0, :, ::-1, ::-1], LIDAR_EXTENT)
