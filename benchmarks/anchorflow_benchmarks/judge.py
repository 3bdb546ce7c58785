"""The judge: which anchors of a scene could be driven, and what they offer.

An anchor succeeds when it is

    free      its centre line, looked at every 2 cm, keeps robot_radius from every occupied cell
              and stays on the map
    reached   it starts at x_curr within 5 cm and 0.1 m/s, and ends within 10 cm of the goal
    feasible  no sample is faster than 1.05 v_max or accelerates by more than 1.1 a_max
    coherent  rms(v - dp/dt) <= 0.03 v_max and rms(a - dv/dt) <= 0.1 a_max (central differences)

Nothing here is shared with the service: what it calls safe is judged, so it may not be the judge.
All anchors of a scene are measured together; what depends on the map alone is worked out once.
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

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.grid_path import shortest_way
from anchorflow_benchmarks.route_judge import ROUTE_MEASURES, RouteJudge
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.ray_signature import Signature
from anchorflow_trajectory.scene import Scene

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SUBCELLS = 4  # of a cell's side, for the distance field
STEP = 0.02  # m between the points at which distance is looked up
ON_MAP = 1e-6  # m by which a point on the map's edge may be beyond it
START, START_VELOCITY, GOAL = 0.05, 0.1, 0.1  # m, m/s, m
SPEED, ACCELERATION = 1.05, 1.1  # of v_max and a_max
VELOCITY_ERROR, ACCELERATION_ERROR = 0.03, 0.1  # of v_max and a_max
SAME_CLASS = 0.5  # rad by which the angles swept round an obstacle may differ within a class
DUPLICATE = 0.02  # m rms between two anchors that are one
NO_OBSTACLE = 99.0  # m, the distance on a map without any
EIGHT_NEIGHBOURS = np.ones((3, 3))

MEASURES = (
    "success",
    "any",
    "free",
    "reached",
    "feasible",
    "coherent",
    "classes",
    "length",
    "jerk",
    "clear",
    "spread",
    "duplicates",
    "unsafe_called_safe",
    *ROUTE_MEASURES,
    "duration",
    "haste",
)


@dataclass(frozen=True)
class Judgement:
    """What holds for each of N anchors of a scene, all [N].

    clearance: m beyond robot_radius, smallest along the path; below -robot_radius off the map
    length: m; jerk: mean size in m/s^3; duration: s; peak: greatest speed in m/s
    measures: the scene's row, by the names of MEASURES; NaN where no anchor succeeds

        success, free, reached, feasible, coherent   shares of the anchors
        any          1 where at least one succeeds, else 0
        classes      homology classes among the successes: ways past the obstacles
        length       of the successes on average, over the shortest path on the grid
        jerk, clear  of the successes on average: m/s^3, m
        spread       m, standard deviation of the positions over the anchors, on average
        duplicates   share of the anchors that have another within 2 cm rms
        unsafe_called_safe   number of anchors promised to be safe that are not free
        recall, first, found, distinct   of the successes, as `RouteJudge` tells them
        duration     of the successes on average: s
        haste        of the quickest success: its duration over `least_duration`

    routes: how many the scene has
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


@dataclass(frozen=True, eq=False)
class SceneJudge:
    """Judges anchors on one scene.

    routes: the signatures of its routes, the shortest first; None to search for them
    """

    scene: Scene
    limits: MotionLimits
    routes: Sequence[Signature] | None = None

    def judge(self, anchors: Proposals) -> Judgement:
        """The verdict on all anchors of a plan."""
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
        routes = len(self.of_routes.listed)
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
            routes,
        )
        good = verdict.success
        verdict.measures.update(self._measures(verdict, position, anchors.safe))
        verdict.measures.update(self.of_routes.measures(position[good]))
        return verdict

    def clearance(self, paths: Array) -> Array:
        """Smallest distance [m] to an obstacle along polylines [N, T, 2], less robot_radius: [N].

        A path that leaves the map counts as one metre inside an obstacle.
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
        """m from each subcell's centre to the nearest occupied one's edge: [4H, 4W]."""
        fine = self.scene.occupied.repeat(SUBCELLS, axis=0).repeat(SUBCELLS, axis=1)
        if not fine.any():
            return np.full(fine.shape, NO_OBSTACLE)
        to_centre = np.asarray(distance_transform_edt(~fine))
        return np.maximum(to_centre - 0.5, 0.0) * self.scene.resolution / SUBCELLS

    @cached_property
    def of_routes(self) -> RouteJudge:
        """The scene's routes, and which of them anchors take."""
        centres = slice(SUBCELLS // 2, None, SUBCELLS)
        room = self._distance[centres, centres] - self.scene.robot_radius
        return RouteJudge(self.scene, room, self.routes)

    @cached_property
    def _obstacle_points(self) -> Array:
        """A point [m] in each connected obstacle: [Q, 2]."""
        labels, _ = label(self.scene.occupied, EIGHT_NEIGHBOURS)  # type: ignore[misc]
        numbers, first = np.unique(labels, return_index=True)
        rows, columns = np.divmod(first[numbers > 0], self.scene.occupied.shape[1])
        return (np.stack([columns, rows], -1) + 0.5) * self.scene.resolution + self.scene.origin

    @cached_property
    def _shortest(self) -> float:
        """m; NaN where the grid has no way."""
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
        names = ("success", "free", "reached", "feasible", "coherent")
        row = {name: float(getattr(verdict, name).mean()) for name in names}
        row |= {"any": float(good.any()), "classes": 0.0}
        row |= dict.fromkeys(("length", "jerk", "clear", "duration", "haste"), np.nan)
        if good.any():
            row["classes"] = float(count_classes(position[good], self._obstacle_points))
            shortest = self._shortest or np.nan  # start and goal in one cell: no ratio
            row["length"] = float(verdict.length[good].mean() / shortest)
            row["jerk"] = float(verdict.jerk[good].mean())
            row["clear"] = float(verdict.clearance[good].mean())
            row["duration"] = float(verdict.duration[good].mean())
            row["haste"] = float(
                verdict.duration[good].min() / least_duration(shortest, self.limits)
            )
        row["spread"] = float(position.std(axis=0).mean())
        row["duplicates"] = duplicate_share(position)
        promised = np.nan if safe is None else float((safe & ~verdict.free).sum())
        return row | {"unsafe_called_safe": promised}


def least_duration(length: float, limits: MotionLimits) -> float:
    """s from rest to rest along so many m at the limits: a trapezoid of speed, or a triangle."""
    v_max, a_max = limits.v_max, limits.a_max
    if length * a_max > v_max**2:
        return length / v_max + v_max / a_max
    return 2.0 * math.sqrt(length / a_max)


def points_along(paths: Array, step: float) -> tuple[Array, NDArray[np.intp]]:
    """Equally spaced points at most `step` apart on polylines [N, T, 2].

    Returns all points [P, 2] path after path, ends included, and where each path's begin [N].
    """
    chords = np.diff(paths, axis=1)
    legs = np.linalg.norm(chords, axis=-1)
    marks = np.pad(np.cumsum(legs, axis=1), ((0, 0), (1, 0)))
    total = marks[:, -1]
    counts = (total / step).astype(int) + 2
    first = np.cumsum(counts) - counts
    path = np.repeat(np.arange(len(paths)), counts)
    at = (np.arange(len(path)) - first[path]) * (total / (counts - 1))[path]
    # One search for all paths: each is moved behind the end of the one before.
    behind = np.cumsum(total + 1.0) - (total + 1.0)
    place = np.searchsorted((marks + behind[:, None]).ravel(), at + behind[path], side="right")
    leg = np.clip(place - 1 - path * marks.shape[1], 0, legs.shape[1] - 1)
    share = (at - marks[path, leg]) / np.where(legs > 0, legs, 1.0)[path, leg]
    points = paths[path, leg] + share[:, None] * chords[path, leg]
    points[first + counts - 1] = paths[:, -1]  # to the last bit: goals lie on edges of cells
    return points, first


def swept_angles(paths: Array, points: Array) -> Array:
    """Angle [rad] that each path [N, T, 2] sweeps as seen from each point [Q, 2]: [N, Q]."""
    rays = paths[:, None] - points[:, None]
    angle = np.arctan2(rays[..., 1], rays[..., 0])
    turn = np.diff(angle, axis=-1)
    # A straight piece sweeps less than half a turn.
    return (turn - 2 * np.pi * np.rint(turn / (2 * np.pi))).sum(-1)


def count_classes(paths: Array, points: Array) -> int:
    """Homology classes among paths [N, T, 2] with common ends, round obstacles at [Q, 2]."""
    swept, classes = swept_angles(paths, points), 0
    while len(swept):
        other = (np.abs(swept - swept[0]) > SAME_CLASS).any(1)
        swept, classes = swept[other], classes + 1
    return classes


def duplicate_share(position: Array) -> float:
    """Share of anchors [N, T, 2] with another within 2 cm rms; 0 for a single one."""
    flat = position.reshape(len(position), -1) / np.sqrt(position.shape[1])
    apart = cdist(flat, flat) + np.diag(np.full(len(flat), np.inf))
    return float((apart.min(1) <= DUPLICATE).mean())


def _largest(vectors: Array) -> Array:
    """Greatest length along each anchor: [N, T, 2] -> [N]."""
    return np.linalg.norm(vectors, axis=-1).max(1)


def _rms(errors: Array) -> Array:
    """Over the inner samples, where differences are central: [N, T, 2] -> [N]."""
    return np.sqrt((errors[:, 1:-1] ** 2).sum(-1).mean(1))
