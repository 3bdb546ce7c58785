"""Judge anchors of a scene: could they be driven, and which ways do they offer?

docs/benchmarks.md lists the criteria of an anchor and the measures of a scene. The judge shares no
code with the service, whose `safe` it checks. A scene's routes are read from a file, or searched to
the last one within the limits on the judge's own distances.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial.distance import cdist

from anchorflow_benchmarks.grid_path import shortest_way
from anchorflow_benchmarks.planners import Proposals
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.homotopy import ObstacleRays, Signature
from anchorflow_trajectory.routes.search import find_routes
from anchorflow_trajectory.scene import Scene

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SUBCELLS = 4  # of a cell's side, for the distance field
STEP = 0.02  # m between the points at which the distance is sampled
ON_MAP = 1e-6  # m, tolerance for points on the map's edge
START, START_VELOCITY, GOAL = 0.05, 0.1, 0.1  # m, m/s, m
SPEED, ACCELERATION = 1.05, 1.1  # of v_max and a_max
VELOCITY_ERROR, ACCELERATION_ERROR = 0.03, 0.1  # of v_max and a_max
SAME_CLASS = 0.5  # rad, tolerance of the angles swept round an obstacle within a class
DUPLICATE = 0.02  # m rms, below which two anchors are duplicates
NO_OBSTACLE = 99.0  # m, the distance on an empty map
# The routes of a scene; a planner may search for more of them.
MAX_ROUTES, STRETCH, SLACK = 8, 1.25, 0.03
DISTINCT = 0.1  # m rms from which two anchors are distinct
ROUTE_MEASURES = ("recall", "first", "found", "distinct")
EIGHT_NEIGHBOURS = np.ones((3, 3))


@dataclass(frozen=True)
class Judgement:
    """The verdict on N anchors of a scene; arrays are [N].

    clearance: m beyond robot_radius, smallest along the path; below -robot_radius off the map
    length: m; jerk: mean size in m/s^3; duration: s; peak: greatest speed in m/s
    measures: the scene's row, whose columns docs/benchmarks.md explains; NaN if no anchor succeeds
    routes: number of routes of the scene
    """

    free: BoolArray
    reached: BoolArray
    feasible: BoolArray
    coherent: BoolArray
    clearance: Array
    length: Array
    jerk: Array
    duration: Array
    peak: Array
    measures: dict[str, float]
    routes: int

    @property
    def success(self) -> BoolArray:
        return self.free & self.reached & self.feasible & self.coherent


@dataclass(frozen=True)
class JudgedPlan:
    """A planner's [N] anchors for a scene, their verdict, and the time in ms."""

    scene: FamilyScene
    anchors: Proposals
    verdict: Judgement
    ms: float


@dataclass(frozen=True, eq=False)
class SceneJudge:
    """Judges anchors on one scene.

    routes: signatures of its routes, shortest first; None to search for them
    """

    scene: Scene
    limits: MotionLimits
    routes: Sequence[Signature] | None = None

    def judge(self, anchors: Proposals) -> Judgement:
        """Judge all anchors of a plan."""
        position, velocity, acceleration = (
            np.asarray(a, np.float64)[..., :2]
            for a in (anchors.positions, anchors.velocities, anchors.accelerations)
        )
        clearance = self.clearance(position)
        free = clearance >= 0.0
        reached = self._reached(position, velocity)
        peak, dt = _largest(velocity), anchors.dts[:, None, None]
        feasible = peak <= SPEED * self.limits.v_max
        feasible &= _largest(acceleration) <= ACCELERATION * self.limits.a_max
        slip = _rms(velocity - np.gradient(position, axis=1) / dt)
        coherent = slip <= VELOCITY_ERROR * self.limits.v_max
        slip = _rms(acceleration - np.gradient(velocity, axis=1) / dt)
        coherent &= slip <= ACCELERATION_ERROR * self.limits.a_max
        length = np.linalg.norm(np.diff(position, axis=1), axis=-1).sum(1)
        jerk = np.linalg.norm(np.diff(acceleration, axis=1) / dt, axis=-1).mean(1)
        verdict = Judgement(
            free,
            reached,
            feasible,
            coherent,
            clearance,
            length,
            jerk,
            anchors.durations,
            peak,
            {},
            len(self.listed_routes),
        )
        verdict.measures.update(self._measures(verdict, position, anchors.safe))
        return verdict

    def clearance(self, paths: Array) -> Array:
        """Return the smallest distance [N] in m to an obstacle along polylines [N, T, 2], less
        robot_radius; a path that leaves the map counts as one metre inside an obstacle.
        """
        scene = self.scene
        points, first = points_along(paths, STEP)
        corner = np.array(scene.occupied.shape[::-1]) * scene.resolution + scene.origin
        beyond = np.maximum(scene.origin - points, points - corner).max(1)
        column, row = ((points - scene.origin) / scene.resolution * SUBCELLS).astype(int).T
        height, width = self._distance.shape
        near = self._distance[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        smallest = np.minimum.reduceat(near, first)
        left = np.maximum.reduceat(beyond, first) > ON_MAP
        return np.where(left, -1.0, smallest) - scene.robot_radius

    @cached_property
    def _distance(self) -> Array:
        """[4H, 4W] m from each subcell's centre to the edge of the nearest occupied subcell."""
        fine = self.scene.occupied.repeat(SUBCELLS, axis=0).repeat(SUBCELLS, axis=1)
        if not fine.any():
            return np.full(fine.shape, NO_OBSTACLE)
        to_centre = np.asarray(distance_transform_edt(~fine))
        return np.maximum(to_centre - 0.5, 0.0) * self.scene.resolution / SUBCELLS

    @cached_property
    def _room(self) -> Array:
        """[H, W] m beyond robot_radius at cell centres."""
        centres = slice(SUBCELLS // 2, None, SUBCELLS)
        return self._distance[centres, centres] - self.scene.robot_radius

    @cached_property
    def listed_routes(self) -> Sequence[Signature]:
        """The signatures of the scene's routes, shortest first."""
        if self.routes is not None:
            return self.routes
        scene = self.scene
        found = find_routes(
            self._room,
            resolution=scene.resolution,
            origin=scene.origin,
            start=scene.x_curr[:2].astype(float),
            goal=scene.x_goal[:2].astype(float),
            most=MAX_ROUTES,
            stretch=STRETCH,
            slack=SLACK,
        )
        return [route.signature for route in found]

    @cached_property
    def _rays(self) -> ObstacleRays:
        return ObstacleRays.of(self._room)

    @cached_property
    def _obstacle_points(self) -> Array:
        """[Q, 2] m, a point in each connected obstacle."""
        labels, _ = label(self.scene.occupied, EIGHT_NEIGHBOURS)  # type: ignore[misc]
        numbers, first = np.unique(labels, return_index=True)
        rows, columns = np.divmod(first[numbers > 0], self.scene.occupied.shape[1])
        return (np.stack([columns, rows], -1) + 0.5) * self.scene.resolution + self.scene.origin

    @cached_property
    def _shortest(self) -> float:
        """m; NaN without a path on the grid."""
        return shortest_way(self.scene)

    def _reached(self, position: Array, velocity: Array) -> BoolArray:
        x_curr, goal = self.scene.x_curr, self.scene.x_goal[:2]
        reached = np.linalg.norm(position[:, 0] - x_curr[:2], axis=1) <= START
        reached &= np.linalg.norm(velocity[:, 0] - x_curr[2:4], axis=1) <= START_VELOCITY
        return reached & (np.linalg.norm(position[:, -1] - goal, axis=1) <= GOAL)

    def _measures(
        self, verdict: Judgement, position: Array, safe: BoolArray | None
    ) -> dict[str, float]:
        good = verdict.success
        names = ("free", "reached", "feasible", "coherent")
        promised = np.nan if safe is None else float((safe & ~verdict.free).sum())
        row = {
            "success": float(good.mean()),
            "any": float(good.any()),
            **{name: float(getattr(verdict, name).mean()) for name in names},
            "classes": 0.0,
            **dict.fromkeys(("length", "jerk", "clear"), np.nan),
            "spread": float(position.std(axis=0).mean()),
            "duplicates": duplicate_share(position),
            "unsafe_called_safe": promised,
            **self._route_measures(position[good]),
            **dict.fromkeys(("duration", "haste"), np.nan),
        }
        if good.any():
            row["classes"] = float(count_classes(position[good], self._obstacle_points))
            shortest = self._shortest or np.nan  # start and goal in one cell have no ratio
            row["length"] = float(verdict.length[good].mean() / shortest)
            row["jerk"] = float(verdict.jerk[good].mean())
            row["clear"] = float(verdict.clearance[good].mean())
            row["duration"] = float(verdict.duration[good].mean())
            row["haste"] = float(
                verdict.duration[good].min() / least_duration(shortest, self.limits)
            )
        return row

    def _route_measures(self, successes: Array) -> dict[str, float]:
        """Return ROUTE_MEASURES of successes [M, T, 2]; NaN if the scene has no route."""
        if not self.listed_routes:
            return dict.fromkeys(ROUTE_MEASURES, np.nan)
        scene = self.scene
        taken = set(
            self._rays.signatures(successes, resolution=scene.resolution, origin=scene.origin)
        )
        return {
            "recall": float(np.mean([route in taken for route in self.listed_routes])),
            "first": float(self.listed_routes[0] in taken),
            "found": float(len(taken)),
            "distinct": float(count_distinct(successes)),
        }


def least_duration(length: float, limits: MotionLimits) -> float:
    """Return the s from rest to rest over a length in m: a trapezoid or triangle of speed."""
    v_max, a_max = limits.v_max, limits.a_max
    if length * a_max > v_max**2:
        return length / v_max + v_max / a_max
    return 2.0 * math.sqrt(length / a_max)


def points_along(paths: Array, step: float) -> tuple[Array, NDArray[np.intp]]:
    """Place equally spaced points at most `step` apart on polylines [N, T, 2].

    Returns all points [P, 2], path after path, ends included, and each path's first index [N].
    """
    chords = np.diff(paths, axis=1)
    legs = np.linalg.norm(chords, axis=-1)
    marks = np.pad(np.cumsum(legs, axis=1), ((0, 0), (1, 0)))
    total = marks[:, -1]
    counts = (total / step).astype(int) + 2
    first = np.cumsum(counts) - counts
    path = np.repeat(np.arange(len(paths)), counts)
    at = (np.arange(len(path)) - first[path]) * (total / (counts - 1))[path]
    # One search for all paths: each is shifted behind the end of the one before.
    behind = np.cumsum(total + 1.0) - (total + 1.0)
    place = np.searchsorted((marks + behind[:, None]).ravel(), at + behind[path], side="right")
    leg = np.clip(place - 1 - path * marks.shape[1], 0, legs.shape[1] - 1)
    share = (at - marks[path, leg]) / np.where(legs > 0, legs, 1.0)[path, leg]
    points = paths[path, leg] + share[:, None] * chords[path, leg]
    points[first + counts - 1] = paths[:, -1]  # exact, because goals may be on cell edges
    return points, first


def swept_angles(paths: Array, points: Array) -> Array:
    """Return the angle [N, Q] in rad that each path [N, T, 2] sweeps seen from points [Q, 2]."""
    rays = paths[:, None] - points[:, None]
    angle = np.arctan2(rays[..., 1], rays[..., 0])
    turn = np.diff(angle, axis=-1)
    # A straight segment sweeps less than half a turn.
    return (turn - 2 * np.pi * np.rint(turn / (2 * np.pi))).sum(-1)


def count_classes(paths: Array, points: Array) -> int:
    """Count homology classes of paths [N, T, 2] with common ends, given obstacles at [Q, 2]."""
    swept, classes = swept_angles(paths, points), 0
    while len(swept):
        other = (np.abs(swept - swept[0]) > SAME_CLASS).any(1)
        swept, classes = swept[other], classes + 1
    return classes


def duplicate_share(position: Array) -> float:
    """Return the share of anchors [N, T, 2] with another within 2 cm rms; 0 for one anchor."""
    flat = position.reshape(len(position), -1) / np.sqrt(position.shape[1])
    apart = cdist(flat, flat) + np.diag(np.full(len(flat), np.inf))
    return float((apart.min(1) <= DUPLICATE).mean())


def count_distinct(paths: Array) -> int:
    """Count the paths [M, T, 2] left after dropping, in order, those near one that is kept."""
    kept = paths[:0]
    for path in paths:
        if (((kept - path) ** 2).sum(-1).mean(-1) >= DISTINCT**2).all():
            kept = np.concatenate([kept, path[None]])
    return len(kept)


def _largest(vectors: Array) -> Array:
    """Return the greatest norm along each anchor: [N, T, 2] -> [N]."""
    return np.linalg.norm(vectors, axis=-1).max(1)


def _rms(errors: Array) -> Array:
    """Return the rms over the inner samples, whose differences are central: [N, T, 2] -> [N]."""
    return np.sqrt((errors[:, 1:-1] ** 2).sum(-1).mean(1))
