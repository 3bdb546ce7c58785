"""What moves: discs along their told tracks, whose clearance depends on time.

Time 0 is the moment at which anchors begin. A disc moves in straight legs of equal time and goes on
as in its last leg; one at constant velocity has a single leg.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.caching import cached_property
from anchorflow_trajectory.compiled import compiled_part

SMALL_BULGE = 0.01  # m from the chord of two samples, beyond which a leg is cut
MOST_PIECES = 64  # of a leg
UNEVEN = 0.1  # of that unevenness, which a spline of degree 4 leaves the piece by, at most
ROUNDING = 1e-3  # m, where legs are passed over
BENT = 1.25  # the second derivative inside a leg over that at its ends, at most


@dataclass(frozen=True, eq=False)
class MovingDiscs:
    """M discs.

    places: float64 [M, K + 1, 2] m, now and at every further `step_s`
    radius: [M] m, now; growth: m/s by which every radius grows
    """

    places: NDArray[np.float64]
    radius: NDArray[np.float64]
    step_s: float = 1.0
    growth: float = 0.0

    @staticmethod
    def of(
        position: FloatArray,
        velocity: FloatArray | None,
        radius: FloatArray,
        *,
        forecast: FloatArray | None = None,
        forecast_dt: float | None = None,
        growth: float = 0.0,
    ) -> MovingDiscs:
        """Build discs at positions [M, 2] with velocities [M, 2], or with a forecast.

        forecast: [M, K, 2] m, after each further `forecast_dt`; it takes the velocity's place
        """
        step_s = 1.0
        if forecast is None:
            assert velocity is not None
            forecast = (position + velocity)[:, None]
        else:
            assert forecast_dt is not None
            step_s = forecast_dt
        places = np.concatenate([position[:, None], forecast], axis=1, dtype=np.float64)
        return MovingDiscs(places, np.asarray(radius, np.float64), float(step_s), float(growth))

    def wider(self, by: float) -> MovingDiscs:
        """Return them with every radius `by` m larger, such as by that of a robot."""
        return replace(self, radius=self.radius + by)

    @cached_property
    def made(self) -> dict[Any, Any]:
        """Return the cache of `Discs` for compiled loops, by dtype."""
        return {}


class Discs(NamedTuple):
    """Moving discs as compiled loops read them, numbers of one type; see `MovingDiscs`.

    lines: [M, K, 4], of each leg the place where it would be at time 0, and the velocity
    pace: [M] m/s, at which each moves or grows towards anything at most

    Where nothing moves, loops get None: they are compiled for that type too, without the discs.
    """

    lines: FloatArray
    radius: FloatArray
    pace: FloatArray
    step: np.floating
    growth: np.floating

    @staticmethod
    def of(movers: MovingDiscs, dtype: DTypeLike) -> Discs:
        """Return the discs in numbers of a dtype, cached."""
        if (made := movers.made.get(dtype)) is None:
            numbers = np.array([movers.step_s, movers.growth], dtype)
            velocity = np.diff(movers.places, axis=1) / movers.step_s
            begun = movers.step_s * np.arange(velocity.shape[1])[:, None]
            lines = np.concatenate([movers.places[:, :-1] - velocity * begun, velocity], axis=-1)
            pace = np.linalg.norm(velocity, axis=-1).max(1, initial=0.0) + movers.growth
            radius, pace = movers.radius.astype(dtype), pace.astype(dtype)
            lines = np.ascontiguousarray(lines, dtype)
            made = movers.made[dtype] = Discs(lines, radius, pace, *numbers)
        return made


@compiled_part
def place_at(discs: Discs, j: int, time: float) -> tuple[float, float]:
    """x and y of disc j after `time` s."""
    leg = 0
    if discs.lines.shape[1] > 1:
        leg = min(int(time / discs.step), discs.lines.shape[1] - 1)
    line = discs.lines[j, leg]
    return line[0] + line[2] * time, line[1] + line[3] * time


@compiled_part
def moving_clearance(
    discs: Discs | None, path: FloatArray, duration: float, enough: float, most: float
) -> float:
    """Return a lower bound of the least clearance [m] to discs along samples [T, 2] and between.

    It stops below `enough`, and returns no more than `most`. Between two samples the motion stays
    within a bulge of its chord, which is followed in continuous time.
    """
    if discs is None:
        return most
    steps, least, legs = len(path), most, discs.lines.shape[1]
    stride, bulge, off = duration / (steps - 1), np.empty(steps), np.zeros(steps)
    longest, widest = 0.0, 0.0
    for t in range(1, steps):
        bulge[t] = _bulge(path, t)
        if not np.isfinite(bulge[t]):
            return -np.inf
        if legs > 1 or bulge[t] > SMALL_BULGE:
            off[t] = UNEVEN * _unevenness(path, t)
        widest = max(widest, bulge[t] + off[t])
        along_x, along_y = path[t, 0] - path[t - 1, 0], path[t, 1] - path[t - 1, 1]
        longest = max(longest, along_x * along_x + along_y * along_y)
    longest = np.sqrt(longest)
    for j in range(len(discs.radius)):
        nearer, t = longest + discs.pace[j] * stride, 1
        while t < steps:
            x, y = _place_from(discs, j, path, t - 1, stride)
            gap = np.sqrt(x * x + y * y) - discs.radius[j] - discs.growth * ((t - 1) * stride)
            # Legs in which the two cannot come nearer than the least so far are passed over.
            passed = (gap - least - widest - ROUNDING) / nearer
            if passed >= 1.0:
                t += int(min(passed, steps))
                continue
            if legs > 1 or bulge[t] > SMALL_BULGE:
                least = min(least, _bent_clearance(discs, j, path, t, stride, bulge[t], off[t]))
            else:
                to_x, to_y = _place_from(discs, j, path, t, stride)
                radius = discs.radius[j] + discs.growth * (t * stride) + bulge[t]
                least = min(least, _least_length(x, y, to_x, to_y) - radius)
            if not least >= enough:
                return least
            t += 1
    return least


@compiled_part
def _place_from(
    discs: Discs, j: int, path: FloatArray, t: int, stride: float
) -> tuple[float, float]:
    """x and y of sample t as seen from disc j, samples `stride` s apart."""
    x, y = place_at(discs, j, t * stride)
    return path[t, 0] - x, path[t, 1] - y


@compiled_part
def _bulge(path: FloatArray, t: int) -> float:
    """Return m by which the motion from sample t - 1 to t may leave its chord."""
    steps = len(path)
    here, there = min(max(t - 1, 1), steps - 2), min(t, steps - 2)
    b_x = path[here - 1, 0] - 2 * path[here, 0] + path[here + 1, 0]
    b_y = path[here - 1, 1] - 2 * path[here, 1] + path[here + 1, 1]
    to_b_x = path[there - 1, 0] - 2 * path[there, 0] + path[there + 1, 0]
    to_b_y = path[there - 1, 1] - 2 * path[there, 1] + path[there + 1, 1]
    bent = max(b_x * b_x + b_y * b_y, to_b_x * to_b_x + to_b_y * to_b_y)
    return BENT * np.sqrt(bent) / 8


@compiled_part
def _bent_clearance(
    discs: Discs, j: int, path: FloatArray, t: int, stride: float, bulge: float, off: float
) -> float:
    """Return the same for one leg and one disc, cut into pieces that are nearly straight.

    In between the second derivative is linear, as in the certificate of what stands still, up to
    `off`, which the second differences tell by their own.
    """
    steps, least = len(path), np.inf
    here, there = min(max(t - 1, 1), steps - 2), min(t, steps - 2)
    pieces = int(min(max(np.ceil(np.sqrt(bulge / SMALL_BULGE)), 1), MOST_PIECES))
    x, y = path[t - 1, 0], path[t - 1, 1]
    for piece in range(1, pieces + 1):
        s = piece / pieces
        lift = s * (1 - s) / 6
        to_x = path[t - 1, 0] + s * (path[t, 0] - path[t - 1, 0])
        to_y = path[t - 1, 1] + s * (path[t, 1] - path[t - 1, 1])
        for which, share in ((here, 2 - s), (there, 1 + s)):
            to_x -= lift * share * (path[which - 1, 0] - 2 * path[which, 0] + path[which + 1, 0])
            to_y -= lift * share * (path[which - 1, 1] - 2 * path[which, 1] + path[which + 1, 1])
        begin, end = (t - 1 + (piece - 1) / pieces) * stride, (t - 1 + s) * stride
        chord = _chord_clearance(discs, j, (x, y), (to_x, to_y), begin, end)
        least = min(least, chord - bulge / (pieces * pieces) - off)
        x, y = to_x, to_y
    return least


@compiled_part
def _unevenness(path: FloatArray, t: int) -> float:
    """Return the greatest second difference [m] of second differences about leg t."""
    most = 0.0
    for middle in range(max(t - 2, 2), min(t + 1, len(path) - 3) + 1):
        square = 0.0
        for d in range(2):
            outer = path[middle - 2, d] + path[middle + 2, d]
            inner = path[middle - 1, d] + path[middle + 1, d]
            uneven = outer - 4.0 * inner + 6.0 * path[middle, d]
            square += uneven * uneven
        most = max(most, square)
    return np.sqrt(most)


@compiled_part
def _chord_clearance(
    discs: Discs,
    j: int,
    place: tuple[float, float],
    target: tuple[float, float],
    begin: float,
    end: float,
) -> float:
    """Return the least clearance to disc j from one place to another, straight, begin to end s."""
    least, radius = np.inf, discs.radius[j] + discs.growth * end
    at, (x, y), legs = begin, place, discs.lines.shape[1]
    while at < end:
        # The disc's own legs cut the chord.
        leg = int(at / discs.step + 1e-9)
        until = min((leg + 1) * discs.step, end) if leg < legs - 1 else end
        share = (until - begin) / (end - begin)
        to_x = place[0] + share * (target[0] - place[0])
        to_y = place[1] + share * (target[1] - place[1])
        q_x, q_y = place_at(discs, j, at)
        to_q_x, to_q_y = place_at(discs, j, until)
        gap = _least_length(x - q_x, y - q_y, to_x - to_q_x, to_y - to_q_y)
        least = min(least, gap - radius)
        at, x, y = until, to_x, to_y
    return least


@compiled_part
def _least_length(x: float, y: float, to_x: float, to_y: float) -> float:
    """Return the least distance of the origin to a straight line between two points."""
    along_x, along_y = to_x - x, to_y - y
    square = along_x * along_x + along_y * along_y
    share = 0.0
    if square > 0.0:
        share = min(max(-(x * along_x + y * along_y) / square, 0.0), 1.0)
    x, y = x + share * along_x, y + share * along_y
    return np.sqrt(x * x + y * y)
