"""What plans meet in what a planner perceives, and what they are worth by that alone.

    worth = NC^2 · DAC · q^8 · e^-beside,   q = (5 EP + 5 TTC + 2 C) / 12 · (1 - close / 2)

NC falls with the predicted occupancy under the front of the tracked car, and with small things that
it touches; TTC with what it touches within 0.9 s at its speed and heading, or passes closely. DAC
is the road under its corners, EP its progress by that of the longest plan that is allowed. `close`
is the share of the time with others in the way of 0.7 s ahead, and `beside` the way off the course.
Of plans that all hit something, the one is best that hits late and slowly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.car.comfort import comfort
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.small_things import SmallThings, cells_at
from anchorflow_trajectory.car.tracking import FRAME_S, STEPS, Motion
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

TIMES = FRAME_S * np.arange(STEPS + 1)
TAKEN, NEARLY = (0.1, 0.4), (0.12, 0.5)
"""Occupancy that is surely free and surely taken: under the car, and ahead of it."""
THING = 0.45
"""Occupancy that a small thing counts as."""
KERB = 0.15
"""m beside the car that should be road."""
ROAD, CROWDED = (0.35, 0.55), (0.1, 0.5)
AHEAD_S = (0.3, 0.6, 0.9)
HEADWAY = ((0.0, 1.0), (0.35, 0.6), (0.7, 0.35))
"""s ahead at which others are too close, each with its weight, beyond STANDOFF."""
STANDOFF = 1.0
"""m."""
FRONT = 2.0, 3.0
"""m before the rear axle at which, and at the bumper, occupancy is read."""
INSET, ASIDE = 0.15, 0.4
"""m inside the car's sides, and outside them for what is passed closely."""
TOUCHES, PASSES = (0.1, 0.3), 0.5
"""m to a small thing, now and further ahead, up to which it is touched; and passed closely."""
PUSHED = 0.3
"""Occupancy of the car's rear by which somebody comes from behind, who is at fault."""
BEFORE_IT, RECENT = (1.0, 2.5), 5
"""m before the bumper at which those have been who do not come from behind, and steps ago."""
MOVES, STANDS = 0.05, 0.3
"""m/s from which on a car moves, and up to which a thing stands."""
FORESEEN_S = 3.0
"""s for which small things keep their velocities."""
LEAST_WAY = 5.0
"""m of progress that are enough if no plan has more."""
BESIDE_M, SOON = 1.5, 20
"""m beside the course that cost little; steps in which a hit counts more."""
OFF_CENTRE = 0.1
"""e^- this for each m beside the course at the end."""
POWER = 8
LOOK_STRIDE = 4


@dataclass(frozen=True, eq=False)
class Sight:
    """What a planner perceives: others as predicted occupancy, road of one layer, small things."""

    taken: Raster
    road: Raster
    things: SmallThings


def worth(motion: Motion, car: Car, sight: Sight, course: Course) -> FloatArray:
    """Return what tracked plans [N] are worth, in [0, 1]."""
    x, y, heading = np.moveaxis(motion.poses, -1, 0)
    body = _Body(x, y, np.cos(heading), np.sin(heading), car, motion.speed)
    hit, ahead, close = _met(body, replace(sight, things=sight.things.near(course)))
    clear, free = 1 - _ramp(hit.max(1), TAKEN), 1 - _ramp(ahead.max(1), NEARLY)
    clear = clear**2 * (1 - 0.9 * _ramp(hit[:, :SOON].max(1), TAKEN))
    on_road = _ramp(_road(body, sight.road), ROAD)
    pleasant = comfort(motion)
    middles = np.stack(body.at(car.middle, 0.0), -1)[:, ::LOOK_STRIDE]
    along, left = course.project(middles)
    way, beside = along[:, -1] - along[:, 0], np.abs(left)
    longest = max((way * clear * on_road * pleasant).max(), LEAST_WAY)
    quality = (5 * (way / longest).clip(0, 1) + 5 * free + 2 * pleasant) / 12
    quality = quality * (1 - _ramp(close, CROWDED).mean(1) / 2)
    off = np.maximum(beside - np.maximum(beside[:, :1], BESIDE_M), 0.0).max(1)
    off += np.maximum(beside[:, -1] - BESIDE_M, 0.0) + OFF_CENTRE * beside[:, -1]
    late = np.where((hit >= TAKEN[1]).any(1), (hit >= TAKEN[1]).argmax(1), STEPS)
    fast = motion.speed[np.arange(len(late)), late]
    least = 1e-4 * (1 + late) / STEPS / (1 + fast) ** 2 * np.exp(-way / 10)
    value = np.minimum(clear * quality**POWER + least, 1.0)
    return value * (0.05 + 0.95 * on_road) * np.exp(-off)


@dataclass(frozen=True, eq=False)
class _Body:
    """A car on N motions at S steps: places, cosines and sines, and speeds [N,S]."""

    x: FloatArray
    y: FloatArray
    cos: FloatArray
    sin: FloatArray
    car: Car
    speed: FloatArray

    def at(self, ahead: FloatArray | float, aside: FloatArray | float) -> tuple[FloatArray, ...]:
        """Return x and y of points so far ahead of the rear axle and to its left."""
        return (
            self.x + ahead * self.cos - aside * self.sin,
            self.y + ahead * self.sin + aside * self.cos,
        )


def _met(body: _Body, sight: Sight) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the occupancy [N,S] that the car hits, that it will hit at its speed or passes
    closely, and that is in the way further ahead."""
    car, speed = body.car, body.speed
    inside, outside = (
        (-car.side + INSET, 0.0, car.side - INSET),
        (-car.side - ASIDE, car.side + ASIDE),
    )
    places = (*FRONT, car.front)

    now = replace(sight.taken, values=sight.taken.values[:1])

    def taken(ahead, asides, later: float = 0.0, *, first: bool = False) -> FloatArray:
        points = (body.at(one + later * speed, aside) for one in ahead for aside in asides)
        raster = now if first else sight.taken
        return np.max([_occupied(raster, x, y, later) for x, y in points], axis=0)

    front, rear = taken(places, inside), taken((-car.rear, 0.0, 1.0), inside)
    before = taken(tuple(car.front + each for each in BEFORE_IT), inside)
    pushed, moves = _pushed(front, rear, before), speed > MOVES
    stands = np.minimum(front, taken(places, inside, first=True))
    ahead = np.maximum(front, taken(places, outside))
    for later in AHEAD_S:
        ahead = np.maximum(ahead, taken((car.front,), inside, later))
    close = np.zeros_like(front)
    for seconds, weight in HEADWAY:
        points = (body.at(car.front + STANDOFF + seconds * speed, aside) for aside in inside)
        close = np.maximum(
            close, weight * np.max([_occupied(sight.taken, x, y) for x, y in points], axis=0)
        )
    hit, ahead, close = (np.where(pushed, stands, each) for each in (front, ahead, close))
    touched, neared = _touched(body, sight.things)
    hit = np.maximum(hit, THING * touched)
    ahead = np.maximum(np.maximum(ahead, hit), NEARLY[1] * neared)
    return hit * moves, ahead * moves, close * moves


def _pushed(front: FloatArray, rear: FloatArray, before: FloatArray) -> BoolArray:
    """Return whether [N,S] those that touch the car have come from behind: they touch its rear
    first, and the place before it was free."""
    touches: BoolArray = front > PUSHED
    since = np.arange(front.shape[1]) - touches.argmax(1)[:, None]
    is_rear = np.any((rear > PUSHED) & (since <= 0), axis=1)
    is_before = np.any((before > TAKEN[0]) & (since <= 0) & (since >= -RECENT), axis=1)
    pushed = np.any(touches, axis=1) & is_rear & ~is_before
    return pushed[:, None] & (since >= 0)


def _occupied(taken: Raster, x: FloatArray, y: FloatArray, later: float = 0.0) -> FloatArray:
    """Return the occupancy at places [N,S] of each step, or so many s after it."""
    layer = np.round((TIMES + later - taken.first_s) / taken.step_s).astype(int)
    inside, row, column = cells_at(taken, x, y)
    return np.where(inside, taken.values[layer.clip(0, len(taken.values) - 1), row, column], 0.0)


def _touched(body: _Body, things: SmallThings) -> tuple[BoolArray, BoolArray]:
    """Return whether [N,S] the car touches a small thing, and whether it soon will or passes one
    closely."""
    shape = body.x.shape
    touched, neared = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    stands = np.hypot(*things.velocities.T) < STANDS
    for later in (0.0, *AHEAD_S[1:]):
        moved = np.minimum(TIMES + later, FORESEEN_S)[:, None]
        x = things.places[:, 0] + moved * things.velocities[:, 0]
        y = things.places[:, 1] + moved * things.velocities[:, 1]
        own_x, own_y = body.at(later * body.speed, 0.0)
        dx, dy = x - own_x[..., None], y - own_y[..., None]
        cos, sin = body.cos[..., None], body.sin[..., None]
        ahead, aside = dx * cos + dy * sin, dy * cos - dx * sin
        beyond = np.maximum(np.abs(ahead - body.car.middle) - body.car.half_length, 0.0)
        apart = np.hypot(beyond, np.maximum(np.abs(aside) - body.car.side, 0.0)) - things.radii
        before = ahead > 1.0
        if not later:
            touched = ((apart < TOUCHES[0]) & (before | stands)).any(-1)
        neared |= ((apart < (TOUCHES[1] if later else PASSES)) & before).any(-1)
    return touched, neared


def _road(body: _Body, road: Raster) -> FloatArray:
    """Return the least share of road [N] under the corners and middles of the car's sides."""
    car, least = body.car, np.ones(len(body.x))
    for ahead in (car.front, car.middle, -car.rear):
        for aside in (-car.side - KERB, car.side + KERB):
            inside, row, column = cells_at(road, *body.at(ahead, aside))
            least = np.minimum(least, np.where(inside, road.values[0, row, column], 1.0).min(1))
    return least


def _ramp(values: FloatArray | NDArray[np.float32], bounds: tuple[float, float]) -> FloatArray:
    """Return 0 up to the lower bound, 1 from the upper on."""
    low, high = bounds
    return ((values - low) / (high - low)).clip(0.0, 1.0)
