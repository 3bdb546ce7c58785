"""What plans meet in what a planner perceives, and what they are worth by that alone.

    worth = NC^2 · DAC · q^4 · e^-beside,   q = (5 EP + 5 TTC + 2 C) / 12

NC falls with the occupancy that was predicted for the place before the tracked car's bumper in the
last LASTING_S, and with small things that it touches: who is ahead may stop, and predicted
occupancy fades with time. TTC falls with what the car touches within 0.9 s at its speed and
heading, or passes closely. DAC is the least share of road under its corners, EP its progress by
that of the longest plan that is allowed, and `beside` the way off the course at the end. Of plans
that all hit something, the shortest is best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.car.comfort import comfort
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.small_things import SmallThings, cells_at
from anchorflow_trajectory.car.tracking import FRAME_S, STEPS, Motion
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

TIMES = FRAME_S * np.arange(STEPS + 1)
TAKEN, NEARLY = (0.1, 0.4), (0.12, 0.5)
"""Occupancy that is surely free and surely taken: under the car, and ahead of it."""
KERB = 0.15
"""m beside the car that should be road."""
AHEAD_S = (0.3, 0.6, 0.9)
"""s at which the place ahead is looked at."""
LASTING_S = 1.25
"""s for which a place stays taken after somebody was predicted there."""
INSET = 0.15
"""m inside the car's sides at which occupancy is read."""
TOUCHES, PASSES = 0.1, 0.5
"""m to a small thing up to which it is touched, and passed closely."""
BRAKES = 3.0
"""m/s² by which small things may brake instead of going on."""
LEAST_WAY, CREEPS = 5.0, 1.0
"""m of progress that are enough if no plan has more, and up to which it is none: a car that creeps
hits those ahead in the end, and leaves the road since it cannot steer."""
SLACK = 2.0
"""m of progress that a plan may have more than it is long, on the inside of a bend."""
OFF_COURSE = 0.3
"""e^- this for each m beside the course at the end."""
LEAST = 1e-6
"""Of a plan that hits somebody or leaves the road."""


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
    hit, ahead = _met(body, replace(sight, things=sight.things.near(course)))
    clear, free = (1 - _ramp(hit.max(1), TAKEN)) ** 2, 1 - _ramp(ahead.max(1), NEARLY)
    on_road = _road(body, sight.road)
    middles = np.stack(body.at(car.middle, 0.0), -1)
    way, beside = _progress(course, middles[0, 0], middles[:, -1], motion.speed.sum(1) * FRAME_S)
    driven = np.where(way < CREEPS, 0.0, way)
    longest = max((driven * clear * on_road).max(), LEAST_WAY)
    quality = (5 * (driven / longest).clip(0, 1) + 5 * free + 2 * comfort(motion)) / 12
    value = clear * on_road * quality**4 * np.exp(-OFF_COURSE * beside)
    return np.minimum(value + LEAST * np.exp(-way / 10), 1.0)


@dataclass(frozen=True, eq=False)
class _Body:
    """A car on N motions at S steps: places, cosines and sines, and speeds [N,S]."""

    x: FloatArray
    y: FloatArray
    cos: FloatArray
    sin: FloatArray
    car: Car
    speed: FloatArray

    def at(
        self, ahead: FloatArray | float, aside: FloatArray | float
    ) -> tuple[FloatArray, FloatArray]:
        """Return x and y of points so far ahead of the rear axle and to its left."""
        return (
            self.x + ahead * self.cos - aside * self.sin,
            self.y + ahead * self.sin + aside * self.cos,
        )


def _met(body: _Body, sight: Sight) -> tuple[FloatArray, FloatArray]:
    """Return the occupancy [N,S] that the car hits, and that it will hit at its speed or passes
    closely."""

    def taken(raster: Raster, times: tuple[float, ...]) -> FloatArray:
        return np.max([_before(body, raster, later) for later in times], axis=0)

    hit, ahead = taken(_lasting(sight.taken), (0.0,)), taken(sight.taken, AHEAD_S)
    apart = _apart(body, sight.things)
    hit = np.maximum(hit, apart < TOUCHES)
    return hit, np.maximum(np.maximum(ahead, hit), apart < PASSES)


def _lasting(taken: Raster) -> Raster:
    """Return what was taken LASTING_S ago or since."""
    layers = taken.values.copy()
    for since in range(1, round(LASTING_S / taken.step_s) + 1):
        layers[since:] = np.maximum(layers[since:], taken.values[:-since])
    return replace(taken, values=layers)


def _before(body: _Body, taken: Raster, later: float) -> FloatArray:
    """Return the occupancy [N,S] of a cell before the bumper, so many s later at its speed."""
    layer = np.round((TIMES + later - taken.first_s) / taken.step_s).astype(int)
    layer = layer.clip(0, len(taken.values) - 1)
    ahead = body.car.front + taken.cell + later * body.speed
    most = np.zeros_like(body.x)
    for aside in (INSET - body.car.side, 0.0, body.car.side - INSET):
        inside, row, column = cells_at(taken, *body.at(ahead, aside))
        most = np.maximum(most, np.where(inside, taken.values[layer, row, column], 0.0))
    return most


def _apart(body: _Body, things: SmallThings) -> FloatArray:
    """Return the m [N,S] to the nearest small thing before the car, which goes on or brakes."""
    car, speed, moved = body.car, np.hypot(*things.velocities.T), TIMES[:, None]
    braked = np.minimum(moved, speed / BRAKES)
    braked = braked * (1 - braked * BRAKES / 2 / np.maximum(speed, 1e-3))
    x, y = (
        np.concatenate([place + moved * velocity, place + braked * velocity], 1)
        for place, velocity in zip(things.places.T, things.velocities.T, strict=True)
    )
    dx, dy = x - body.x[..., None], y - body.y[..., None]
    cos, sin = body.cos[..., None], body.sin[..., None]
    ahead, aside = dx * cos + dy * sin, dy * cos - dx * sin
    beyond = np.maximum(np.abs(ahead - car.middle) - car.half_length, 0.0)
    apart = np.hypot(beyond, np.maximum(np.abs(aside) - car.side, 0.0)) - np.tile(things.radii, 2)
    return np.where(ahead > 0.0, apart, np.inf).min(-1, initial=np.inf)


def _progress(
    course: Course, start: FloatArray, ends: FloatArray, driven: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the m [N] along a course from a place to others, and how far they are beside it.

    driven: m [N], beyond which no progress is looked for: a course may cross itself
    """
    begin, _ = course.project(start)
    away = np.linalg.norm(course.points - ends[:, None], axis=-1)
    away[course.arc_length > begin + driven[:, None] + SLACK] = np.inf
    nearest = away.argmin(1)
    return course.arc_length[nearest] - begin, away[np.arange(len(ends)), nearest]


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
