"""Ways of a body: searched along the map's routes, and split into stretches of one gear."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.bodies.curves import KEPT, LAST, basis_for, fitted, slid
from anchorflow_trajectory.bodies.motion import COLUMNS, tabulate
from anchorflow_trajectory.bodies.scene import BodyScene
from anchorflow_trajectory.bodies.search import Guide, find_way, guide_along
from anchorflow_trajectory.bodies.shots import Target
from anchorflow_trajectory.bodies.wheels import (
    BACKWARD,
    FORWARD,
    SLIDING,
    STANDING,
    TURNING,
    moves_of,
)
from anchorflow_trajectory.caching import cached_property
from anchorflow_trajectory.routes.search import Route
from anchorflow_trajectory.spline.basis import DEGREE, SplineBasis, spline_basis

Run = Callable[[Sequence[Callable[[], object]]], None]
"""Calls functions, side by side if it likes."""

GUIDE_CELLS, GUIDE_STEP = 64, 0.15  # most cells of a guide's side, and m between its points
TRIES = ((0.035, 1.0, 1.12), (0.015, 1.0, 1.12), (0.013, 0.5, 1.02))
"""Margins [m] about the outline that a search keeps, its cell in shares of the usual one, and a
factor on the tightest turn: bends of a spline are tighter than those of what it follows."""
MOST_WAYS, MOST_POSES, FEWER_POSES = 4, 5000, 500  # tried; poses of the first's search and others'
FINE = 8  # rows of a span


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of a way in one gear: its basis and base curve, or on the spot its poses [2, 3]."""

    gear: int
    poses: FloatArray
    basis: SplineBasis | None
    control: FloatArray
    held: int
    last: int

    @property
    def rows(self) -> int:
        """Rows of its table."""
        if self.basis is None:
            return FINE
        return FINE * (self.basis.num_control_points - DEGREE) + 1

    @property
    def course(self) -> float:
        """The direction [rad] of the motion at its end."""
        if self.gear == SLIDING:
            x, y = self.control[-1, :2] - self.control[-2, :2]
            return float(np.arctan2(y, x))
        return float(self.poses[-1, 2]) + np.pi * (self.gear == BACKWARD)

    def tables(self, controls: FloatArray | None, count: int) -> NDArray[np.float64]:
        """Return tables [N, R, 8] of its curves [N, K, D]."""
        if self.basis is None or controls is None:
            rows = np.zeros((FINE, COLUMNS))
            share = np.linspace(0.0, 1.0, FINE)[:, None]
            first, last = self.poses[0], self.poses[-1]
            rows[:, :1] = share * abs(last[2] - first[2])
            rows[:, 1:4] = first + share * (last - first)
            return np.broadcast_to(rows, (count, FINE, COLUMNS))
        rows = np.empty((count, self.rows, COLUMNS))
        band = spline_basis(self.rows, num_control_points=self.basis.num_control_points)
        tabulate(controls, band.band(np.float64), self.gear, float(self.poses[0, 2]), rows)
        return rows


@dataclass(frozen=True, eq=False)
class WaySearch:
    """Finds the ways of a problem; run: of the searches."""

    problem: BodyScene
    run: Run

    def find(self, certified: float) -> Iterator[list[list[Stretch]]]:
        """Yield ways on which the body fits, the cheapest first, until some can be driven.

        Each list is of a finer search than the one before. Where none finds a way, the only list is
        a way that the body does not fit through.
        """
        # Both are worked out here, side by side, and not by each search anew.
        self.run([lambda: self.problem.scene.routes, lambda: self.problem.goal])
        routes, any_found = self.problem.scene.routes[:MOST_WAYS], False
        for margin, finer, spare in TRIES:
            cell = finer * self.problem.cell
            if ways := self._different(self._searched(routes, margin + certified, cell, spare)):
                yield [self._stretches(way) for way in ways]
                any_found = True
        if not any_found:
            yield [self._stretches(self._along(routes))]

    def _searched(
        self, routes: Sequence[Route], margin: float, cell: float, spare: float
    ) -> list[NDArray[np.float64]]:
        """Return the ways [P, 4] that are found along routes."""
        found = [np.empty((0, 4))] * len(routes)

        def search(k: int) -> None:
            for turn, back in enumerate(self.ends, 1):
                most = FEWER_POSES if k or turn < len(self.ends) else MOST_POSES
                found[k], tried = self._search(routes[k], margin, cell, spare, most, back=back)
                if len(found[k]) or tried == 1:  # the body cannot move at this end at all
                    return

        self.run([partial(search, k) for k in range(len(routes))])
        return [way for way in found if len(way) > 1]

    @cached_property
    def ends(self) -> tuple[bool, ...]:
        """Whether searches begin at the goal: first at the end where the body has less room.

        What is hard about a way is near that end, and beyond it the other is soon reached.
        """
        problem = self.problem
        if not problem.heading_counts:
            return (False,)
        room, most = problem.room_at(problem.goal), 0.5 * problem.body.outline.reach
        tighter = room < min(problem.room_at(problem.start), most)
        return tighter, not tighter

    def _search(
        self,
        route: Route,
        margin: float,
        cell: float,
        spare: float,
        most: int,
        *,
        back: bool,
    ) -> tuple[NDArray[np.float64], int]:
        """Return a way [P, 4] along a route, or an empty one, and how many poses were expanded.

        back: searched from the goal
        """
        scene, lead, gear = self.problem.scene, self.problem.lead, self.problem.first_gear
        braking = 0.0 if len(lead) > 1 else self.problem.braking
        outline = self.problem.body.outline.grown(margin)
        start, goal = lead[-1], self.problem.goal
        target = Target(goal, self.problem.heading_counts, STANDING, 0.0)
        if back:
            start, target = goal, Target(start, True, _reversed(gear), braking)
            gear, braking = STANDING, 0.0
        motion = scene.motion
        moves = moves_of(
            self.problem.body.wheels,
            cell=cell,
            v_max=motion.v_max,
            a_max=motion.a_max,
            spare=spare,
            back=back,
        )
        dear = scene.surcharge
        way, expanded = find_way(
            self.problem.ground, outline.corners, outline.reach, moves, cell,
            self._guide(route, cell, back=back),
            np.zeros((0, 0), np.float32) if dear is None else np.ascontiguousarray(dear),
            start, gear, braking, target, most,
        )  # fmt: skip
        if back and len(way):
            way = _turned_round(way, target.pose[2])
        if len(lead) > 1 and len(way):
            way = np.concatenate([np.insert(lead[:-1], 3, SLIDING, 1), way], dtype=np.float64)
        return way, expanded

    def _guide(self, route: Route, cell: float, *, back: bool) -> Guide:
        """Return what is left of a way along a route, to the goal or back to the start."""
        scene = self.problem.scene
        corner = np.asarray(scene.origin, np.float64)
        size = np.array(scene.occupied.shape) * scene.resolution
        fine = max(2.0 * cell, float(size.max()) / GUIDE_CELLS)
        legs = np.hypot(*np.diff(route.points, axis=0).T)
        marks = np.append(0.0, legs.cumsum())
        at = np.linspace(0.0, marks[-1], max(2, int(marks[-1] / max(GUIDE_STEP, fine))))
        points = np.stack([np.interp(at, marks, axis) for axis in route.points.T], 1)
        shape = (int(np.ceil(size[0] / fine)), int(np.ceil(size[1] / fine)))
        return guide_along(points, at if back else marks[-1] - at, shape, corner, fine)

    def _different(self, ways: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Return the ways that differ in the sides or gears they take, the shortest first."""
        kept: dict[object, NDArray[np.float64]] = {}
        for way in sorted(ways, key=self._cost):
            gears = tuple(gear for gear, other in pairwise([*way[1:, 3], 9.0]) if gear != other)
            key = (gears, *self.problem.classes(way[None, :, :2]))
            kept.setdefault(key, way)
        return list(kept.values())

    def _cost(self, way: NDArray[np.float64]) -> float:
        """s that a way takes about."""
        motion, wheels = self.problem.scene.motion, self.problem.body.wheels
        length = np.hypot(*np.diff(way[:, :2], axis=0).T).sum()
        turned = np.abs(np.diff(way[:, 2]))[way[1:, 3] == TURNING].sum()
        stops = np.count_nonzero(np.diff(way[1:, 3]))
        lasts = length / motion.v_max + turned / wheels.omega_max
        return float(lasts + stops * motion.v_max / motion.a_max)

    def _along(self, routes: Sequence[Route]) -> NDArray[np.float64]:
        """Return the way [P, 4] along the cheapest route, for a body that fits on none."""
        ends = np.stack([self.problem.start[:2], self.problem.goal[:2]])
        points = routes[0].points if routes else ends
        legs = np.diff(points, axis=0)
        points = points[np.append(True, np.hypot(*legs.T) > 1e-6)]
        if len(points) < 2:
            points = np.stack([points[0], points[0] + 1e-3])
        if self.problem.body.wheels.slides:
            way = np.full((len(points), 4), float(SLIDING))
            way[:, :2], way[:, 2] = points, self.problem.start[2]
            return way
        heading = np.unwrap(np.arctan2(*np.diff(points, axis=0).T[::-1]))
        turn = (heading[0] - self.problem.start[2] + np.pi) % (2.0 * np.pi) - np.pi
        heading += self.problem.start[2] + turn - heading[0]
        way = np.ones((len(points), 4))
        way[:, :2], way[:, 2] = points, np.append(heading, heading[-1])
        if self.problem.body.wheels.spot and abs(turn) > 1e-3:
            on_spot = np.array(
                [[*points[0], self.problem.start[2], 1.0], [*points[0], heading[0], 0.0]]
            )
            return np.concatenate([on_spot, way[1:]])
        way[0, 2] = self.problem.start[2]
        return way

    def _stretches(self, way: NDArray[np.float64]) -> list[Stretch]:
        """Split a way where its gear changes, and fit curves to what is driven."""
        cuts = np.flatnonzero(np.diff(way[1:, 3])) + 1
        bounds = [0, *cuts.tolist(), len(way) - 1]
        stretches = []
        for k, (begin, end) in enumerate(pairwise(bounds)):
            gear = int(way[end, 3])
            poses = way[begin : end + 1, :3]
            if gear == TURNING:
                empty = np.empty((0, 2))
                stretches.append(Stretch(gear, poses[[0, -1]], None, empty, 0, 0))
                continue
            fixed_end = k < len(bounds) - 2 or self.problem.heading_counts
            length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
            basis = basis_for(length, self.problem.cell)
            bend = self.problem.first_bend if k == 0 and self.problem.moves else None
            if gear == SLIDING:
                first = None if bend is None else np.append(self.problem.scene.x_curr[3:5], bend)
                control = slid(poses, basis, first)
                held, last = 1 + KEPT * (first is not None), 1
            else:
                control = fitted(poses, basis, gear, fixed_end=fixed_end, bend=bend)
                held, last = KEPT + (bend is not None), LAST if fixed_end else 1
            stretches.append(Stretch(gear, poses, basis, control, held, last))
        return stretches


def _reversed(gear: int) -> int:
    """Return the gear of a motion that is run backwards in time."""
    return -gear if gear in (FORWARD, BACKWARD) else gear


def _turned_round(way: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    """Return a way [P, 4] from its end to its start; heading: rad, of the end."""
    turned = way[::-1].copy()
    turned[1:, 3] = [_reversed(int(gear)) for gear in way[:0:-1, 3]]
    turned[:, 2] += heading - turned[0, 2]
    return turned
