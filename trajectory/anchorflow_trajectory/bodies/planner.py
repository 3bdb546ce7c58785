"""Anchors for a body with a heading: N motions along ways that it fits through and can drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.bodies.curves import KEPT, Pull, settle
from anchorflow_trajectory.bodies.evasion import evading
from anchorflow_trajectory.bodies.motion import CLOSE, COLUMNS, certify, drive, room_to_movers
from anchorflow_trajectory.bodies.scene import BETWEEN, LEAST_CELL, BodyScene
from anchorflow_trajectory.bodies.ways import Run, Stretch, WaySearch
from anchorflow_trajectory.bodies.wheels import TURNING
from anchorflow_trajectory.finish.refined import Refined, numbered
from anchorflow_trajectory.movers import Discs

RIM, COARSE_RIM = 0.12, 0.2  # m between two points of the outline; in descents
SETTLING, LONG = 12, 80  # steps of a descent, and of a way's own curve
WIDE, LEAST_MARGIN, MOST_MARGIN = 0.18, 0.04, 0.3  # m: noise of anchors, and room that they seek
ROOM, BEND, SOFT, EVEN, SHORT, RATE = 30.0, 1.0, 1.0, 2.0, 0.1, 0.25
"""Weights of a descent, and its first step in cells."""
AIMED, ALLOWED = 0.96, 1.02  # of the tightest turn's curvature
SHARPEST = 30.0  # 1/m, of the course of who slides: a corner, and no spike of a curve
EASY_TURN = 0.5  # share of v_max at which bends are driven at omega_max
SHARES = (1.0, 0.5)  # of an anchor's own shape, tried until it is safe
EASED_S = 1.5  # s from the start, in which shapes begin to differ
PART = 16  # anchors of a task, on however many threads
PACED = 2  # anchors of one shape, which differ in pace
PACES = (0.7, 0.97)  # shares of v_max
YIELDS = ((0.0, 1.0), (0.0, 0.6), (0.6, 1.0), (1.5, 1.0), (3.0, 1.0), (0.0, 0.35), (6.0, 1.0))
"""Waits [s] and factors on the speed, tried until nothing that moves is met."""
BLOCKED = 10.0  # score that an anchor loses which is not safe
COMFORT = 0.4  # m of room from which more is worth nothing


@dataclass(frozen=True, eq=False)
class BodyPlanner:
    """Plans for one problem; steps: T; run: of the work of ways."""

    problem: BodyScene
    steps: int
    run: Run

    def plan(self, count: int, seed: int, certified_margin: float = 0.0) -> Refined:
        """Return `count` anchors with positions [N, T, 3]: x and y in m, heading in rad."""
        lines: list[tuple[BodyPlanner, _Line]] = [
            (self, line) for line in self._lines(certified_margin)
        ]
        if self.problem.scene.movers is not None:
            lines = self._past_movers(lines, certified_margin)
        drawn, paces = _drawn(count, seed)
        # Anchors take the ways by turns; the first of each way keeps the way's own curve.
        of_line = [np.arange(k, count, len(lines)) for k in range(min(count, len(lines)))]
        for own in of_line:
            drawn[own[0]] = 0.0
        parts = [
            (k, own[begin : begin + PART])
            for k, own in enumerate(of_line)
            for begin in range(0, len(own), PART)
        ]
        driven = [_Driven.empty(0, self.steps)] * len(parts)

        def finish(at: int) -> None:
            k, own = parts[at]
            planner, line = lines[k]
            driven[at] = planner._anchors(line, drawn[own[::PACED]], paces[own], certified_margin)

        self.run([partial(finish, at) for at in range(len(parts))])
        numbers = np.concatenate([np.full(len(own), k) for k, own in parts])
        return self._joined(driven, numbers)

    def _lines(self, certified: float) -> list[_Line]:
        """Return the lines of the ways of the first search of which one is safe."""
        unsafe: list[_Line] = []
        for ways in WaySearch(self.problem, self.run).find(certified):
            lines = [_Line.empty(way) for way in ways]

            def lay(k: int, ways: list[list[Stretch]] = ways, lines: list[_Line] = lines) -> None:
                lines[k] = self._line(ways[k], certified)

            self.run([partial(lay, k) for k in range(len(ways))])
            # A way whose own curve touches something gets no anchors while another does not.
            if safe := [line for line in lines if line.safe]:
                return safe
            unsafe = unsafe or lines
        return unsafe

    def _past_movers(
        self, lines: list[tuple[BodyPlanner, _Line]], certified: float
    ) -> list[tuple[BodyPlanner, _Line]]:
        """Return the lines that pass what moves, and others round where the first meets it.

        Each has the planner for its map; all are returned if none passes.
        """
        poses, durations = self._at_paces(lines[0][1])
        if (self._room_to_movers(poses, durations) < certified).any():
            beside = replace(self, problem=evading(self.problem, poses, durations))
            lines = lines + [(beside, line) for line in beside._lines(certified) if line.safe]
        passes = [False] * len(lines)

        def attempt(k: int) -> None:
            owner, line = lines[k]
            shapes = np.zeros((1, 2, 3))
            found = owner._anchors(line, shapes, np.array(PACES), certified)
            passes[k] = bool(found.safe.any())

        self.run([partial(attempt, k) for k in range(len(lines))])
        return [line for k, line in enumerate(lines) if passes[k]] or lines

    def _at_paces(self, line: _Line) -> tuple[FloatArray, FloatArray]:
        """Return the poses [P, T, 3] along a line at each of the PACES, and their durations [P]."""
        driven, every = _Driven.empty(len(PACES), self.steps), np.arange(len(PACES))
        table = np.repeat(line.table, len(PACES), 0)
        self._drive(line, table, driven, every, np.array(PACES), 0.0)
        return driven.motion[0], driven.duration

    def _room_to_movers(self, poses: FloatArray, durations: FloatArray) -> FloatArray:
        """Return [N] m of room that poses [N, T, 3] leave to what moves."""
        outline, movers = self.problem.body.outline, self.problem.scene.movers
        assert movers is not None
        discs = Discs.of(movers, np.float64)
        return room_to_movers(poses, durations, discs, outline.corners, outline.reach)

    def _line(self, way: list[Stretch], certified: float) -> _Line:
        """Return a way's own curve, with room about it if that can be had."""
        settled = [self._settled(s, s.control[None].copy(), LEAST_MARGIN, LONG) for s in way]
        line = _Line.empty(way)
        for controls in (settled, [each.control[None] for each in way]):
            table, safe, room = self._checked(line, controls, certified, whole=True)
            line = replace(line, controls=controls, table=table, safe=safe[0], room=room[0])
            if line.safe:
                break
        return line

    def _checked(
        self,
        line: _Line,
        controls: Sequence[FloatArray],
        certified: float,
        *,
        whole: bool = False,
    ) -> tuple[FloatArray, BoolArray, FloatArray]:
        """Return the tables [N, R, 8] of curves [N, K, D], which are safe, and their room [N] m.

        whole: whether the room of those that are not safe counts
        """
        outline, wheels = self.problem.body.outline, self.problem.body.wheels
        grown = outline.grown(BETWEEN + certified)
        clear = 0.5 * RIM + BETWEEN + certified + CLOSE + self.problem.scene.resolution
        most_bend = ALLOWED / wheels.min_radius if wheels.min_radius > 0.0 else np.inf
        if wheels.slides:
            most_bend = SHARPEST
        number = max(len(each) for each in controls)
        rows = [s.tables(c, number) for s, c in zip(line.way, controls, strict=True)]
        table = np.concatenate(rows, axis=1)
        safe, least = certify(
            table, line.gears, line.begins, self.problem.ground, grown.corners, grown.reach,
            outline.rim(RIM), self.problem.room, clear, most_bend, whole,
        )  # fmt: skip
        return table, safe, least

    def _anchors(
        self, line: _Line, drawn: FloatArray, paces: FloatArray, certified: float
    ) -> _Driven:
        """Return anchors along a way, with shapes drawn [N / PACED, 2, 3] and paces [N].

        One whose shape is not safe, or cannot be driven from the start on, takes the way's own.
        """
        count = len(paces)
        table, shaped, room = self._shaped(line, drawn, certified)
        of_shape = np.arange(count) // PACED
        table, shaped, room = table[of_shape], shaped[of_shape], room[of_shape]
        driven = _Driven.empty(count, self.steps)
        driven.safe[:], driven.room[:] = line.safe | shaped, room
        keeps = self._drive(line, table, driven, np.arange(count), paces, 0.0)
        if len(stiff := np.flatnonzero(shaped & ~keeps)):
            table[stiff], driven.room[stiff] = line.table, line.room
            own_keeps = self._drive(line, table, driven, stiff, paces[stiff], 0.0)
            keeps[stiff] = own_keeps & line.safe
        driven.safe[:] &= keeps
        if self.problem.moves and line.way[0].gear != self.problem.first_gear:
            driven.safe[:] = False
        self._pass_movers(line, table, driven, paces, certified)
        return driven

    def _shaped(
        self, line: _Line, drawn: FloatArray, certified: float
    ) -> tuple[FloatArray, BoolArray, FloatArray]:
        """Return tables [S, R, 8] of shapes, which of them are safe, and their room [S] m.

        One that is not safe is the way's own.
        """
        controls = line.controls
        own = [self._varied(s, c[0], drawn) for s, c in zip(line.way, controls, strict=True)]
        table, room = np.repeat(line.table, len(drawn), 0), np.full(len(drawn), line.room)
        shaped = np.zeros(len(drawn), np.bool_)
        for share in SHARES:
            chosen = np.flatnonzero(~shaped)
            if not len(chosen):
                break
            pairs = zip(controls, own, strict=True)
            mixed = [base + share * (other[chosen] - base) for base, other in pairs]
            rows, safe, least = self._checked(line, mixed, certified)
            done = chosen[safe]
            table[done], room[done], shaped[done] = rows[safe], least[safe], True
        return table, shaped, room

    def _drive(
        self,
        line: _Line,
        table: FloatArray,
        driven: _Driven,
        chosen: NDArray[np.intp],
        paces: FloatArray,
        wait: float,
    ) -> BoolArray:
        """Write the motions of the anchors that are chosen; returns whether limits are kept."""
        motion = np.zeros((3, len(chosen), self.steps, 3))
        durations = np.empty(len(chosen))
        lasts = self.problem.scene.motion.horizon_s or 0.0
        last = line.way[-1]
        end = 0.0 if last.gear == TURNING else self.problem.last_speed(last.course)
        keeps = drive(
            table[chosen], line.gears, line.begins, self.problem.limits,
            np.ascontiguousarray(paces),
            np.full(len(chosen), wait), abs(self.problem.first_speed), end, lasts, motion,
            durations,
        )  # fmt: skip
        driven.motion[:, chosen], driven.duration[chosen] = motion, durations
        return keeps

    def _pass_movers(
        self,
        line: _Line,
        table: FloatArray,
        driven: _Driven,
        paces: FloatArray,
        certified: float,
    ) -> None:
        """Let anchors that meet something that moves wait, or drive slower, until they do not."""
        if self.problem.scene.movers is None:
            return
        free, room = driven.safe.copy(), driven.room.copy()
        chosen = np.flatnonzero(free)
        for wait, slower in YIELDS:
            if wait or slower != 1.0:
                if wait and self.problem.moves:
                    continue
                own = slower * paces[chosen]
                free[chosen] &= self._drive(line, table, driven, chosen, own, wait)
            if not len(chosen):
                return
            found = self._room_to_movers(driven.motion[0, chosen], driven.duration[chosen])
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
        """Descend on curves [N, K, D], which change, to `margin` m of room each."""
        if stretch.basis is None:
            return controls
        rim, reach = self.problem.body.outline.rim(COARSE_RIM), self.problem.body.outline.reach
        wheels, motion = self.problem.body.wheels, self.problem.scene.motion
        most_bend = wheels.omega_max / (EASY_TURN * motion.v_max)
        if wheels.min_radius > 0.0:
            most_bend = AIMED / wheels.min_radius
        margins = np.broadcast_to(np.float64(margin), len(controls))
        pull = Pull(ROOM, most_bend, BEND, SOFT, EVEN, SHORT, RATE * self.problem.cell)
        settle(
            controls, np.ascontiguousarray(margins), stretch.basis.band(np.float64), stretch.held,
            stretch.last, stretch.gear, rim, reach, self.problem.room, self.problem.dear, pull,
            steps,
        )  # fmt: skip
        return controls

    def _varied(self, stretch: Stretch, base: FloatArray, drawn: FloatArray) -> FloatArray:
        """Return curves [N, K, D] beside a base [K, D], as drawn [N, 2, 3] says; settled."""
        count = len(drawn)
        if stretch.basis is None:
            return np.empty((count, 0, 2))
        points = len(base)
        along = np.gradient(base[:, :2], axis=0)
        along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
        across = np.stack([-along[:, 1], along[:, 0]], 1)
        share = np.linspace(0.0, 1.0, points)
        waves = np.sin(np.pi * np.arange(1, 4)[:, None] * share) / np.arange(1, 4)[:, None]
        wide = WIDE * self.problem.cell / LEAST_CELL
        # Who is fast has no room for a bend at once.
        legs = float(np.hypot(*np.diff(base[:, :2], axis=0).T).sum())
        speed = abs(self.problem.first_speed) if stretch.held > KEPT else 0.0
        eased = np.minimum(share * legs / max(EASED_S * speed, 1e-9), 1.0)
        offset = wide * drawn[:, 0] @ waves * eased**2
        offset[:, : stretch.held] = 0.0
        offset[:, points - stretch.last :] = 0.0
        controls = np.repeat(base[None], count, 0)
        controls[..., :2] += offset[..., None] * across
        safety = float(self.problem.scene.effective_style[0])
        wish = np.clip(np.abs(drawn[:, 1, 0]) * (0.4 + safety) / 1.6, 0.0, 1.0)
        margins = LEAST_MARGIN + (MOST_MARGIN - LEAST_MARGIN) * wish
        return self._settled(stretch, np.ascontiguousarray(controls), margins)

    def _joined(self, parts: Sequence[_Driven], numbers: NDArray[np.int64]) -> Refined:
        """Return all anchors with their scores; numbers: [N] of their ways."""
        motion = np.concatenate([part.motion for part in parts], 1)
        duration = np.concatenate([part.duration for part in parts])
        safe = np.concatenate([part.safe for part in parts])
        room = np.concatenate([part.room for part in parts])
        scores = self._scores(motion, duration, room) - BLOCKED * ~safe
        classes = list(zip(numbers.tolist(), self.problem.classes(motion[0, ..., :2]), strict=True))
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
        scene, limits = self.problem.scene, self.problem.scene.motion
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


def _drawn(count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what shapes are drawn from [N, 2, 3], and paces [N]."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 2, 3)), rng.uniform(*PACES, count)


@dataclass(frozen=True, eq=False)
class _Line:
    """A way's own curve: control points of each stretch [1, K, D], table [1, R, 8], and verdict.

    gears: [G] of its stretches; begins: [G + 1], their first rows in the table
    """

    way: list[Stretch]
    gears: NDArray[np.int64]
    begins: NDArray[np.int64]
    controls: Sequence[FloatArray] = ()
    table: FloatArray = field(default_factory=lambda: np.empty((1, 0, COLUMNS)))
    safe: bool = False
    room: float = np.inf

    @staticmethod
    def empty(way: list[Stretch]) -> _Line:
        """Return the line of a way, without its curve."""
        begins = np.append(0, np.cumsum([each.rows for each in way]))
        return _Line(way, np.array([each.gear for each in way]), begins)


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
