"""Anchors for a body with a heading: N motions along ways that it fits through and can drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.bodies.curves import KEPT, LAST, Pull, basis_for, fitted, settle
from anchorflow_trajectory.bodies.motion import (
    CLOSE,
    COLUMNS,
    Limits,
    certify,
    drive,
    room_to_movers,
    tabulate,
)
from anchorflow_trajectory.bodies.outline import Ground, Outline, ground_of, touches
from anchorflow_trajectory.bodies.search import Guide, Target, find_way, guide_along
from anchorflow_trajectory.bodies.wheels import (
    BACKWARD,
    FORWARD,
    STANDING,
    TURNING,
    Wheels,
    moves_of,
)
from anchorflow_trajectory.caching import cached_property
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.cost.fields import Grid
from anchorflow_trajectory.finish.refiner import Refined, numbered
from anchorflow_trajectory.movers import Discs
from anchorflow_trajectory.routes.search import Route
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import DEGREE, SplineBasis, spline_basis

Run = Callable[[Sequence[Callable[[], None]]], None]
"""Calls functions, side by side if it likes."""

CELL_SHARE, LEAST_CELL, MOST_CELL = 0.3, 0.08, 1.0  # of a search: of the inner radius, and m
GUIDE_CELLS, GUIDE_STEP = 64, 0.15  # most cells of a guide's side, and m between its points
TRIES = ((0.035, 1.0), (0.015, 1.0), (0.013, 0.5))
"""Margins [m] about the outline that a search keeps, and its cell in shares of the usual one."""
BETWEEN = 0.012  # m that the outline moves between two poses that are tested, from either
MOST_WAYS, MOST_POSES, FEWER_POSES = 4, 5000, 500  # tried; poses of the first's search and others'
RIM = 0.12  # m between two points of the outline
FINE = 8  # rows of a span
SETTLING, LONG = 16, 60  # steps of a descent, and of a way's own curve
WIDE, LEAST_MARGIN, MOST_MARGIN = 0.18, 0.04, 0.3  # m: noise of anchors, and room that they seek
BEND = 1.0  # weight of bends that are too tight
SHARES = (1.0, 0.5, 0.0)  # of an anchor's own shape, tried until it is safe
PACES = (0.7, 0.97)  # shares of v_max
WINDOW = 0.45  # s of the average, in v_max / a_max
MOVING = 0.02  # m/s
RINGS, DIRECTIONS = (0.45, 0.9), np.arange(12) / 6.0  # of a tolerance, and in half turns
HEADINGS = np.array([0.0, 0.4, -0.4, 0.9, -0.9])  # of a tolerance
YIELDS = ((0.0, 1.0), (0.0, 0.6), (0.6, 1.0), (1.5, 1.0), (3.0, 1.0), (0.0, 0.35), (6.0, 1.0))
"""Waits [s] and factors on the speed, tried until nothing that moves is met."""
BLOCKED = 10.0  # score that an anchor loses which is not safe
COMFORT = 0.4  # m of room from which more is worth nothing


@dataclass(frozen=True)
class Body:
    """A robot's outline and wheels."""

    outline: Outline
    wheels: Wheels


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

    def tables(self, controls: FloatArray | None, count: int) -> NDArray[np.float64]:
        """Return tables [N, R, 6] of its curves [N, K, 2]."""
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
class BodyPlanner:
    """Plans for one scene, whose `robot_radius` is the outline's inner radius.

    tolerance: m and rad about the goal's place and heading at which a way may end if the outline
        does not fit there; None for the heading: any will do
    steps: T; run: of the work of ways
    """

    scene: Scene
    body: Body
    tolerance: tuple[float, float | None]
    steps: int
    run: Run

    def plan(self, count: int, seed: int, certified_margin: float = 0.0) -> Refined:
        """Return `count` anchors with positions [N, T, 3]: x and y in m, heading in rad."""
        ways = self._ways(certified_margin)
        share = _shares(len(ways), count)
        rng = np.random.default_rng(seed)
        parts: list[_Driven | None] = [None] * len(ways)
        drawn = [rng.normal(size=(n, 2, 3)) for n in share]
        paces = [rng.uniform(*PACES, n) for n in share]

        def finish(k: int) -> None:
            parts[k] = self._anchors(ways[k], drawn[k], paces[k], certified_margin)

        self.run([partial(finish, k) for k in range(len(ways))])
        return self._joined([part for part in parts if part is not None])

    # The ways.

    def _ways(self, certified: float) -> list[list[Stretch]]:
        """Return the ways on which the body fits, the cheapest first; at least one."""
        routes = self.scene.routes[:MOST_WAYS]
        for margin, finer in TRIES:
            found: list[NDArray[np.float64]] = [np.empty((0, 4))] * len(routes)

            def search(k: int, margin: float = margin, finer: float = finer) -> None:
                most = FEWER_POSES if k else MOST_POSES
                cell = finer * self._cell
                found[k] = self._search(routes[k], margin + certified, cell, most)  # noqa: B023

            self.run([partial(search, k) for k in range(len(routes))])
            if ways := self._different([way for way in found if len(way) > 1]):
                return [self._stretches(way) for way in ways]
        return [self._stretches(self._along(routes))]

    def _search(self, route: Route, margin: float, cell: float, most: int) -> NDArray[np.float64]:
        """Return a way [P, 4] along a route, or an empty one."""
        scene, start = self.scene, self._start
        outline = self.body.outline.grown(margin)
        motion = scene.motion
        origin = np.asarray(scene.origin, np.float64)
        size = np.array(scene.occupied.shape) * scene.resolution
        fine = max(2.0 * cell, float(size.max()) / GUIDE_CELLS)
        legs = np.hypot(*np.diff(route.points, axis=0).T)
        marks = np.append(0.0, legs.cumsum())
        at = np.linspace(0.0, marks[-1], max(2, int(marks[-1] / max(GUIDE_STEP, fine))))
        points = np.stack([np.interp(at, marks, axis) for axis in route.points.T], 1)
        shape = (int(np.ceil(size[0] / fine)), int(np.ceil(size[1] / fine)))
        left = guide_along(points, marks[-1] - at, shape, origin, fine)
        dear = scene.surcharge
        way, _ = find_way(
            self._ground,
            outline.corners,
            outline.reach,
            moves_of(self.body.wheels, cell=cell, v_max=motion.v_max, a_max=motion.a_max),
            cell,
            Guide(left, float(origin[0]), float(origin[1]), fine),
            np.zeros((0, 0), np.float32) if dear is None else np.ascontiguousarray(dear),
            start,
            self._first_gear if self._moves else STANDING,
            0.5 * self._first_speed**2 / (0.7 * motion.a_max) if self._moves else 0.0,
            Target(self._goal, self._heading_counts),
            most,
        )
        return way

    def _different(self, ways: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Return the ways that differ in the sides or gears they take, the shortest first."""
        kept: dict[object, NDArray[np.float64]] = {}
        for way in sorted(ways, key=self._cost):
            gears = tuple(gear for gear, other in pairwise([*way[1:, 3], 9.0]) if gear != other)
            key = (gears, *self._classes(way[None, :, :2]))
            kept.setdefault(key, way)
        return list(kept.values())

    def _cost(self, way: NDArray[np.float64]) -> float:
        """s that a way takes about."""
        motion, wheels = self.scene.motion, self.body.wheels
        length = np.hypot(*np.diff(way[:, :2], axis=0).T).sum()
        turned = np.abs(np.diff(way[:, 2]))[way[1:, 3] == TURNING].sum()
        stops = np.count_nonzero(np.diff(way[1:, 3]))
        lasts = length / motion.v_max + turned / wheels.omega_max
        return float(lasts + stops * motion.v_max / motion.a_max)

    def _along(self, routes: Sequence[Route]) -> NDArray[np.float64]:
        """Return the way [P, 4] along the cheapest route, for a body that fits on none."""
        ends = np.stack([self._start[:2], self._goal[:2]])
        points = routes[0].points if routes else ends
        legs = np.diff(points, axis=0)
        points = points[np.append(True, np.hypot(*legs.T) > 1e-6)]
        if len(points) < 2:
            points = np.stack([points[0], points[0] + 1e-3])
        heading = np.unwrap(np.arctan2(*np.diff(points, axis=0).T[::-1]))
        turn = (heading[0] - self._start[2] + np.pi) % (2.0 * np.pi) - np.pi
        heading += self._start[2] + turn - heading[0]
        way = np.ones((len(points), 4))
        way[:, :2], way[:, 2] = points, np.append(heading, heading[-1])
        if self.body.wheels.spot and abs(turn) > 1e-3:
            on_spot = np.array([[*points[0], self._start[2], 1.0], [*points[0], heading[0], 0.0]])
            return np.concatenate([on_spot, way[1:]])
        way[0, 2] = self._start[2]
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
            fixed_end = k < len(bounds) - 2 or self._heading_counts
            length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
            basis = basis_for(length, self._cell)
            bend = self._first_bend if k == 0 and self._moves else None
            control = fitted(poses, basis, gear, fixed_end=fixed_end, bend=bend)
            held = KEPT + (bend is not None)
            last = LAST if fixed_end else 1
            stretches.append(Stretch(gear, poses, basis, control, held, last))
        return stretches

    # The anchors.

    def _anchors(
        self, way: list[Stretch], drawn: FloatArray, paces: FloatArray, certified: float
    ) -> _Driven:
        """Return anchors along a way, with shapes drawn [N, 2, 3] and paces [N]."""
        count, outline = len(drawn), self.body.outline
        grown = outline.grown(BETWEEN + certified)
        gears = np.array([each.gear for each in way])
        begins = np.append(0, np.cumsum([each.rows for each in way]))
        wheels, rim = self.body.wheels, outline.rim(RIM)
        clear = 0.5 * RIM + BETWEEN + certified + CLOSE + self.scene.resolution
        most_bend = 1.02 / wheels.min_radius if wheels.min_radius > 0.0 else np.inf

        def checked(controls: list[FloatArray]) -> tuple[FloatArray, BoolArray, FloatArray]:
            number = max(len(each) for each in controls)
            rows = [s.tables(c, number) for s, c in zip(way, controls, strict=True)]
            table = np.concatenate(rows, axis=1)
            safe, least = certify(
                table, gears, begins, self._ground, grown.corners, grown.reach, rim,
                self._room, clear, most_bend,
            )  # fmt: skip
            return table, safe, least

        raw = [each.control[None] for each in way]
        settled = [self._settled(s, s.control[None].copy(), LEAST_MARGIN, LONG) for s in way]
        rows, safe, least = checked(settled)
        if not safe[0]:
            settled = raw
            rows, safe, least = checked(raw)
        own = [self._varied(s, c[0], drawn) for s, c in zip(way, settled, strict=True)]
        table, is_safe = np.repeat(rows, count, 0), np.repeat(safe, count)
        room = np.repeat(least, count)
        todo = np.arange(count) > 0
        for share in SHARES[:-1]:
            chosen = np.flatnonzero(todo)
            if not len(chosen):
                break
            mixed = [
                base + share * (other[chosen] - base)
                for base, other in zip(settled, own, strict=True)
            ]
            rows, safe, least = checked(mixed)
            done = chosen[safe]
            table[done], is_safe[done], room[done] = rows[safe], True, least[safe]
            todo[done] = False
        driven = _Driven.empty(count, self.steps)
        timed = partial(self._drive, table, gears, begins, self._last_speed(way[-1]))
        keeps = timed(driven, np.arange(count), paces, 0.0)
        keeps &= not self._moves or way[0].gear == self._first_gear
        driven.room[:] = room
        driven.safe[:] = is_safe & keeps
        self._pass_movers(driven, timed, paces, certified)
        return driven

    def _drive(
        self,
        table: FloatArray,
        gears: NDArray[np.int64],
        begins: NDArray[np.int64],
        end: float,
        driven: _Driven,
        chosen: NDArray[np.intp],
        paces: FloatArray,
        wait: float,
    ) -> BoolArray:
        """Write the motions of the anchors that are chosen; returns whether limits are kept."""
        motion = np.zeros((3, len(chosen), self.steps, 3))
        durations = np.empty(len(chosen))
        lasts = self.scene.motion.horizon_s or 0.0
        keeps = drive(
            table[chosen], gears, begins, self._limits, np.ascontiguousarray(paces),
            np.full(len(chosen), wait), abs(self._first_speed), end, lasts, motion, durations,
        )  # fmt: skip
        driven.motion[:, chosen], driven.duration[chosen] = motion, durations
        return keeps

    def _pass_movers(
        self,
        driven: _Driven,
        timed: Callable[..., BoolArray],
        paces: FloatArray,
        certified: float,
    ) -> None:
        """Let anchors that meet something that moves wait, or drive slower, until they do not."""
        if self.scene.movers is None:
            return
        discs = Discs.of(self.scene.movers, np.float64)
        outline, free, room = self.body.outline, driven.safe.copy(), driven.room.copy()
        chosen = np.flatnonzero(free)
        for wait, slower in YIELDS:
            if wait or slower != 1.0:
                if wait and self._moves:
                    continue
                free[chosen] &= timed(driven, chosen, slower * paces[chosen], wait)
            if not len(chosen):
                return
            found = room_to_movers(
                driven.motion[0, chosen], driven.duration[chosen], discs, outline.corners,
                outline.reach,
            )  # fmt: skip
            driven.safe[chosen] = free[chosen] & (found >= certified)
            driven.room[chosen] = np.minimum(room[chosen], found)
            chosen = chosen[~driven.safe[chosen]]

    def _settled(
        self,
        stretch: Stretch,
        controls: FloatArray,
        margin: float | FloatArray,
        steps: int = SETTLING,
    ) -> FloatArray:
        """Descend on curves [N, K, 2], which change, to `margin` m of room each."""
        if stretch.basis is None:
            return controls
        rim, reach = self.body.outline.rim(RIM), self.body.outline.reach
        wheels, motion = self.body.wheels, self.scene.motion
        most_bend = wheels.omega_max / (0.5 * motion.v_max)
        if wheels.min_radius > 0.0:
            most_bend = 0.96 / wheels.min_radius
        margins = np.broadcast_to(np.float64(margin), len(controls))
        pull = Pull(30.0, most_bend, BEND, 1.0, 2.0, 0.1, 0.25 * self._cell)
        settle(
            controls, np.ascontiguousarray(margins), stretch.basis.band(np.float64), stretch.held,
            stretch.last, stretch.gear, rim, reach, self._room, self._dear, pull, steps,
        )  # fmt: skip
        return controls

    def _varied(self, stretch: Stretch, base: FloatArray, drawn: FloatArray) -> FloatArray:
        """Return curves [N, K, 2] beside a base [K, 2], as drawn [N, 2, 3] says; settled."""
        count = len(drawn)
        if stretch.basis is None:
            return np.empty((count, 0, 2))
        points = len(base)
        along = np.gradient(base, axis=0)
        along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
        across = np.stack([-along[:, 1], along[:, 0]], 1)
        share = np.linspace(0.0, 1.0, points)
        waves = np.sin(np.pi * np.arange(1, 4)[:, None] * share) / np.arange(1, 4)[:, None]
        wide = WIDE * self._cell / LEAST_CELL
        offset = wide * drawn[:, 0] @ waves
        offset[:, : stretch.held] = 0.0
        offset[:, points - stretch.last :] = 0.0
        controls = base + offset[..., None] * across
        safety = float(self.scene.effective_style[0])
        wish = np.clip(np.abs(drawn[:, 1, 0]) * (0.4 + safety) / 1.6, 0.0, 1.0)
        margins = LEAST_MARGIN + (MOST_MARGIN - LEAST_MARGIN) * wish
        return self._settled(stretch, np.ascontiguousarray(controls), margins)

    def _joined(self, parts: Sequence[_Driven]) -> Refined:
        """Return the anchors of all ways with their scores, those of a way next to one another."""
        motion = np.concatenate([part.motion for part in parts], 1)
        duration = np.concatenate([part.duration for part in parts])
        safe = np.concatenate([part.safe for part in parts])
        room = np.concatenate([part.room for part in parts])
        scores = self._scores(motion, duration, room) - BLOCKED * ~safe
        numbers = np.repeat(np.arange(len(parts)), [len(part.safe) for part in parts])
        classes = list(zip(numbers.tolist(), self._classes(motion[0, ..., :2]), strict=True))
        position, velocity, acceleration = motion.astype(np.float32)
        return Refined(
            position,
            velocity,
            acceleration,
            duration,
            scores.astype(np.float32),
            room.astype(np.float32),
            safe,
            numbered(classes, scores),
        )

    def _scores(self, motion: FloatArray, duration: FloatArray, room: FloatArray) -> FloatArray:
        """Return [N], higher is better: quick, far from obstacles and smooth, as the style says."""
        scene, limits = self.scene, self.scene.motion
        safety, energy, smooth = scene.effective_style
        speed = np.hypot(motion[1, ..., 0], motion[1, ..., 1])
        pull = np.hypot(motion[2, ..., 0], motion[2, ..., 1])
        reference = max(scene.reference_s, 1e-3)
        near = np.clip(1.0 - room / COMFORT, 0.0, None) ** 2
        cost = duration / reference * (0.5 + energy)
        cost += safety * (near + (speed**2).mean(1) / limits.v_max**2)
        cost += smooth * (pull**2).mean(1) / limits.a_max**2
        if scene.cost_fields.surcharge is not None:
            x, y = motion[0, ..., 0].astype(np.float32), motion[0, ..., 1].astype(np.float32)
            dear = scene.cost_fields.surcharge.sample(x, y)
            way = (dear * speed).mean(1) * duration
            cost += way / (limits.v_max * reference)
        return -cost

    def _classes(self, plane: FloatArray) -> list[object]:
        scene = self.scene
        if not len(scene.rays.rows):
            return [()] * len(plane)
        return [*scene.rays.signatures(plane, resolution=scene.resolution, origin=scene.origin)]

    # What follows from the scene.

    @property
    def _start(self) -> NDArray[np.float64]:
        return np.array(self.scene.x_curr[:3], np.float64)

    @property
    def _heading_counts(self) -> bool:
        return self.tolerance[1] is not None

    @cached_property
    def _goal(self) -> NDArray[np.float64]:
        """[3], the goal, or the nearest pose within its tolerance at which the outline fits."""
        goal = np.array(self.scene.x_goal[:3], np.float64)
        within, turn = self.tolerance
        turns = HEADINGS[:1] if turn is None else HEADINGS * turn
        ring = np.stack([np.cos(np.pi * DIRECTIONS), np.sin(np.pi * DIRECTIONS)], 1)
        places = [np.zeros((1, 2)), *(share * within * ring for share in RINGS)]
        outline = self.body.outline.grown(BETWEEN)
        spans = np.empty((2, self._ground.room.shape[0]))
        for place in np.concatenate(places[: 1 + len(RINGS) * (within > 0.0)]):
            for aside in turns:
                pose = goal + np.array([*place, aside])
                headings = pose[2] + np.pi * DIRECTIONS if turn is None else pose[2:]
                for heading in headings:
                    tried = np.array([pose[0], pose[1], heading])
                    if not touches(self._ground, outline.corners, outline.reach, tried, spans):
                        return pose
        return goal

    @property
    def _first_speed(self) -> float:
        """m/s along the heading; a robot on wheels has no other."""
        heading, velocity = self.scene.x_curr[2], self.scene.x_curr[3:5]
        return float(velocity[0] * np.cos(heading) + velocity[1] * np.sin(heading))

    @property
    def _first_gear(self) -> int:
        return BACKWARD if self._first_speed < 0.0 else FORWARD

    @property
    def _moves(self) -> bool:
        return abs(self._first_speed) > MOVING

    @property
    def _first_bend(self) -> float:
        """1/m, the curvature that the robot drives at the start."""
        bend = float(self.scene.x_curr[5]) / abs(self._first_speed)
        radius = self.body.wheels.min_radius
        most = 1.0 / radius if radius > 0.0 else 2.0
        return float(np.clip(bend, -most, most))

    def _last_speed(self, stretch: Stretch) -> float:
        """m/s at the goal, along the last stretch."""
        if stretch.gear == TURNING:
            return 0.0
        heading = stretch.poses[-1, 2]
        x, y = self.scene.x_goal[3:5]
        return max(float(stretch.gear * (x * np.cos(heading) + y * np.sin(heading))), 0.0)

    @property
    def _cell(self) -> float:
        return float(np.clip(CELL_SHARE * self.body.outline.inner, LEAST_CELL, MOST_CELL))

    @cached_property
    def _limits(self) -> Limits:
        motion, wheels = self.scene.motion, self.body.wheels
        most_bend = 1.0 / wheels.min_radius if wheels.min_radius > 0.0 else np.inf
        window = float(np.clip(WINDOW * motion.v_max / motion.a_max, 0.1, 0.6))
        return Limits(motion.v_max, motion.a_max, wheels.omega_max, most_bend, window)

    @cached_property
    def _ground(self) -> Ground:
        scene = self.scene
        return ground_of(scene.occupied, scene.resolution, np.asarray(scene.origin))

    @cached_property
    def _room(self) -> Grid:
        ground = self._ground
        return Grid.of(GridField(ground.room, ground.resolution, self.scene.origin), np.float64)

    @cached_property
    def _dear(self) -> Grid:
        return Grid.of(self.scene.cost_fields.surcharge, np.float64)


@dataclass(frozen=True, eq=False)
class _Driven:
    """Anchors along one way: motion [3, N, T, 3], durations [N] s, verdicts and room [N] m."""

    motion: FloatArray
    duration: FloatArray
    safe: BoolArray
    room: FloatArray

    @staticmethod
    def empty(count: int, steps: int) -> _Driven:
        """Return anchors to be written."""
        numbers = np.zeros((3, count, steps, 3)), np.zeros(count)
        return _Driven(*numbers, np.zeros(count, np.bool_), np.full(count, np.inf))


def _shares(ways: int, count: int) -> list[int]:
    """Return how many of `count` anchors each way gets: about as many each."""
    return [count // ways + (k < count % ways) for k in range(ways)]
