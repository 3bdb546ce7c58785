"""What plans are worth among others who may go several ways.

    worth = NC · DAC · ((5 EP + 5 TTC + 2 C) / 12)^8

is a PDM score of what is driven, expected over the others' modes. Each plan is tracked by the
controller of `tracking`. NC and TTC are the chances that the car hits nobody, and that nothing is
touched within 0.9 s at its speed and heading, if the others choose their modes independently. DAC
is whether the car stays on the road, C whether the drive is comfortable, and EP its progress by
that of the longest that is likely to be allowed, or of a reference if that is shorter. The power
was chosen on simulated logs (docs/goalflow-bundle.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.car.comfort import comfort
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.tracking import (
    FRAME_S,
    PLAN_TIMES,
    STEPS,
    EgoState,
    Motion,
    interpolate,
    track,
)
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

POWER = 8
FREE_PROGRESS = 5.0
"""m; progress counts only if some plan exceeds it."""
LAST_LOOK = 9
"""Steps that the time to collision looks ahead at most."""
STANDS = 0.3
"""m/s, of a foreseen box up to which it stands: who touches it is at fault from any side."""
ROAD = 0.45, 0.55
"""Shares of road under a corner, below and above which it is certainly off and on the road."""
STATIC_PENALTY = 0.5
"""Of hitting what nobody foresees to move."""
STOPPED, MOVES = 0.05, 0.005
"""m/s, up to which a car is at fault for nothing, and from which on it needs time."""
BEHIND = 5 * np.pi / 6
"""rad off the heading, beyond which who touches the car comes from behind."""
OWN_M = 0.75
"""m about a box in which occupied cells are its own."""
LEAST = 0.1
"""Share of a cell from which on something stands there."""


@dataclass(frozen=True, eq=False)
class Foreseen:
    """What is there, in the frame of the rear axle now.

    poses: [A,M,50,3] of the others' middles in each mode, FRAME_S apart from the start on
    probabilities: [A,M]; half: [A,2] half lengths and widths
    standing: [P,2] places that something else takes
    """

    poses: FloatArray
    probabilities: FloatArray
    half: FloatArray
    standing: FloatArray


def foreseen_poses(now: FloatArray, futures: FloatArray, *, from_s: float = 0.0) -> FloatArray:
    """Return poses [A,M,50,3] from `from_s` on of others at `now` [A,3] and then at futures
    [A,M,8,3].

    After their last poses the others go on as in the last step.
    """
    first = np.broadcast_to(now[:, None, None], (*futures.shape[:2], 1, 3))
    poses = np.concatenate([first, futures], 2, dtype=np.float64)
    poses[..., 2] = np.unwrap(poses[..., 2], axis=2)
    after = 2 * poses[:, :, -1:] - poses[:, :, -2:-1]
    after[..., 2] = poses[:, :, -1:, 2]
    poses = np.concatenate([poses, after], 2)
    place = (from_s + np.arange(STEPS + 1 + LAST_LOOK) * FRAME_S) / PLAN_TIMES[0]
    leg = np.minimum(place.astype(int), len(PLAN_TIMES))
    share = (place - leg)[:, None]
    return poses[:, :, leg] * (1 - share) + poses[:, :, leg + 1] * share


def standing_places(occupied: Raster, now: FloatArray, half: FloatArray) -> FloatArray:
    """Return the middles [P,2] of cells of the first layer that are taken by none of the boxes.

    now: [A,3] poses of the boxes; half: [A,2]
    """
    row, column = np.nonzero(occupied.values[0] >= LEAST)
    high = np.array([occupied.extent[1], occupied.extent[3]])
    places = high - (np.stack([row, column], -1) + 0.5) * occupied.cell
    away = places[:, None] - now[:, :2]
    cos, sin = np.cos(now[:, 2]), np.sin(now[:, 2])
    ahead = np.abs(away[..., 0] * cos + away[..., 1] * sin)
    aside = np.abs(away[..., 1] * cos - away[..., 0] * sin)
    own = (ahead <= half[:, 0] + OWN_M) & (aside <= half[:, 1] + OWN_M)
    return places[~own.any(1)]


@dataclass(frozen=True, eq=False)
class Expected:
    """What N plans are expected to be scored for.

    kept: [N] chance that nobody is hit and the road is kept; ahead: [N] chance that TTC holds
    comfortable: [N] 0 or 1; way: [N] m of progress
    """

    kept: FloatArray
    ahead: FloatArray
    comfortable: FloatArray
    way: FloatArray

    @property
    def longest(self) -> float:
        """m, of the longest way that is likely to be allowed."""
        return float((self.way * self.kept * self.comfortable).max())

    def quality(self, longest: float, *, free: float = FREE_PROGRESS) -> FloatArray:
        """Return (5 EP + 5 TTC + 2 C) / 12 [N]; progress by `longest` counts if it exceeds `free`
        m."""
        progress = np.minimum(self.way / max(longest, free), 1.0)
        if longest <= free:
            progress = np.ones_like(progress)
        return (5 * progress + 5 * self.ahead + 2 * self.comfortable) / 12

    def worth(self, *, reference: float = np.inf) -> FloatArray:
        """Return what the plans are worth, [N] in [0, 1].

        reference: m of progress that is enough
        """
        return self.kept * self.quality(min(self.longest, reference)) ** POWER


@dataclass(frozen=True, eq=False)
class Driven:
    """N plans as they are driven.

    on_road: [N] how sure the road is kept; comfortable: [N] 0 or 1; way: [N] m of progress
    """

    motion: Motion
    car: Car
    on_road: FloatArray
    comfortable: FloatArray
    way: FloatArray

    @classmethod
    def of(
        cls,
        plans: FloatArray,
        start: EgoState,
        car: Car,
        road: Raster,
        *,
        wheelbase: float,
        course: Course | None = None,
    ) -> Driven:
        """Track plans [N,8,3] at 0.5 … 4.0 s after their start.

        road: one layer, how sure each cell is road; wheelbase: m
        course: along which progress is measured; by default along what is driven
        """
        poses = np.concatenate([np.tile(start.pose, (len(plans), 1, 1)), plans], 1)
        motion = track(interpolate(np.asarray(poses, np.float64)), start, wheelbase=wheelbase)
        if course is None:
            way = np.linalg.norm(np.diff(motion.poses[..., :2], axis=1), axis=-1).sum(1)
        else:
            x, y, heading = np.moveaxis(motion.poses[:, [0, -1]], -1, 0)
            middles = [x + car.middle * np.cos(heading), y + car.middle * np.sin(heading)]
            along, _ = course.project(np.stack(middles, -1))
            way = np.maximum(along[:, 1] - along[:, 0], 0.0)
        return cls(motion, car, _on_road(motion, car, road), comfort(motion), way)

    def __getitem__(self, plans: slice) -> Driven:
        own = self.on_road[plans], self.comfortable[plans], self.way[plans]
        return Driven(self.motion[plans], self.car, *own)

    def among(self, foreseen: Foreseen) -> Expected:
        """Return what the plans are expected to be scored for among others."""
        clear, ahead = _chances(self.motion, self.car, foreseen)
        return Expected(clear * self.on_road, ahead, self.comfortable, self.way)


def _chances(motion: Motion, car: Car, foreseen: Foreseen) -> tuple[FloatArray, FloatArray]:
    """Return the chances [N] of NC and TTC."""
    count, modes = foreseen.probabilities.shape
    boxes = _frames(foreseen.poses.reshape(count * modes, *foreseen.poses.shape[2:]))
    body = np.array([car.middle, car.half_length, car.side])
    poses, speed = _frames(motion.poses), np.ascontiguousarray(motion.speed)
    touched = np.zeros((2, len(poses), len(boxes)))
    _touched(poses, speed, body, boxes, foreseen.half.repeat(modes, 0), _standing(boxes), touched)
    share = touched.reshape(2, len(poses), count, modes) * foreseen.probabilities
    clear, ahead = (1 - np.minimum(share.sum(-1), 1.0)).prod(-1)
    stood = np.zeros((2, len(poses)))
    _touches(poses, speed, body, np.ascontiguousarray(foreseen.standing), stood)
    return clear * (1 - STATIC_PENALTY * stood[0]), ahead * (1 - stood[1])


def _frames(poses: FloatArray) -> FloatArray:
    """Return x, y, cos, sin [...,4] of poses [...,3]."""
    x, y, heading = np.moveaxis(poses, -1, 0)
    return np.stack([x, y, np.cos(heading), np.sin(heading)], -1)


def _standing(boxes: FloatArray) -> BoolArray:
    """Return [B,S] whether boxes [B,S,4] stand then."""
    moved = np.linalg.norm(np.diff(boxes[..., :2], axis=1), axis=-1)
    return np.concatenate([moved, moved[:, -1:]], 1) <= STANDS * FRAME_S


def _on_road(motion: Motion, car: Car, road: Raster) -> FloatArray:
    """Return [N] how sure it is that all corners stay on the road; beyond the raster all is."""
    ahead = np.array([car.front, car.front, -car.rear, -car.rear])
    left = np.array([car.side, -car.side, car.side, -car.side])
    x, y, heading = np.moveaxis(motion.poses[:, 1:, None], -1, 0)
    cos, sin = np.cos(heading), np.sin(heading)
    row = (road.extent[1] - x - ahead * cos + left * sin) / road.cell - 0.5
    column = (road.extent[3] - y - ahead * sin - left * cos) / road.cell - 0.5
    values = road.values[0]
    rows, columns = values.shape
    row, column = row.clip(0, rows - 1), column.clip(0, columns - 1)
    i, j = (place.astype(int).clip(0, most - 2) for place, most in ((row, rows), (column, columns)))
    down, right = row - i, column - j
    upper = (1 - right) * values[i, j] + right * values[i, j + 1]
    lower = (1 - right) * values[i + 1, j] + right * values[i + 1, j + 1]
    least = ((1 - down) * upper + down * lower).min((1, 2))
    low, high = ROAD
    return ((least - low) / (high - low)).clip(0.0, 1.0)


@compiled
def _touched(poses, speed, body, boxes, half, stands, touched):
    """Write to [2,N,B] which motions are at fault for touching a box, and which leave it no time.

    Their first contact decides. poses: [N,S,4] of the rear axle; speed: [N,S]; boxes:
    [B,S + LAST_LOOK,4]; both are x, y, cos, sin
    """
    count, steps = speed.shape
    done = np.zeros((2, count, len(boxes)), np.bool_)
    near, reach = np.empty(len(boxes), np.int64), np.empty(len(boxes))
    for i in range(steps):
        few = _near(poses, speed, body, boxes, half, i, near, reach)
        for n in range(count):
            if speed[n, i] < MOVES:
                continue
            for k in range(few):
                b, most = near[k], reach[k] + speed[n, i] * LAST_LOOK * FRAME_S
                dx, dy = boxes[b, i, 0] - poses[n, i, 0], boxes[b, i, 1] - poses[n, i, 1]
                if dx * dx + dy * dy > most * most or (done[0, n, b] and done[1, n, b]):
                    continue
                beside = _contact(poses, speed, body, boxes, half, n, i, b, 0)
                if beside >= 0 and speed[n, i] > STOPPED and not done[0, n, b]:
                    done[0, n, b] = True
                    touched[0, n, b] = stands[b, i] or beside <= BEHIND
                for look in (3, 6, 9):
                    if beside < 0 and not done[1, n, b]:
                        beside = _contact(poses, speed, body, boxes, half, n, i, b, look)
                if beside >= 0 and not done[1, n, b]:
                    done[1, n, b] = True
                    touched[1, n, b] = beside <= BEHIND


@compiled_part
def _near(poses, speed, body, boxes, half, i, near, reach):
    """Write which boxes any motion may touch from a step on for LAST_LOOK, and the m from the rear
    axle within which one that stands may; return how many."""
    own = body[0] + body[1] + body[2]
    x_low, x_high = poses[:, i, 0].min(), poses[:, i, 0].max()
    y_low, y_high = poses[:, i, 1].min(), poses[:, i, 1].max()
    fastest = speed[:, i].max() * LAST_LOOK * FRAME_S
    few = 0
    for b in range(len(boxes)):
        x, y = boxes[b, i, 0], boxes[b, i, 1]
        moves = np.hypot(boxes[b, i + LAST_LOOK, 0] - x, boxes[b, i + LAST_LOOK, 1] - y)
        most = own + half[b, 0] + half[b, 1] + moves
        far = most + fastest
        if x_low - far <= x <= x_high + far and y_low - far <= y <= y_high + far:
            near[few], reach[few] = b, most
            few += 1
    return few


@compiled_part
def _contact(poses, speed, body, boxes, half, n, i, b, look):
    """The rad off the heading at which a car touches a box if it goes on for `look` steps; -1 if it
    does not."""
    cos, sin = poses[n, i, 2], poses[n, i, 3]
    dx, dy = boxes[b, i + look, 0] - poses[n, i, 0], boxes[b, i + look, 1] - poses[n, i, 1]
    ahead = dx * cos + dy * sin - body[0] - speed[n, i] * look * FRAME_S
    aside = dy * cos - dx * sin
    length, width = half[b, 0], half[b, 1]
    if abs(ahead) + abs(aside) > 2 * (body[1] + body[2] + length + width):
        return -1.0
    box_cos, box_sin = boxes[b, i + look, 2], boxes[b, i + look, 3]
    c, s = box_cos * cos + box_sin * sin, box_sin * cos - box_cos * sin
    turned, tilted = abs(c), abs(s)
    if abs(ahead) > body[1] + length * turned + width * tilted:
        return -1.0
    if abs(aside) > body[2] + length * tilted + width * turned:
        return -1.0
    if abs(ahead * c + aside * s) > length + body[1] * turned + body[2] * tilted:
        return -1.0
    if abs(aside * c - ahead * s) > width + body[1] * tilted + body[2] * turned:
        return -1.0
    return abs(np.arctan2(aside, dx * cos + dy * sin))


@compiled
def _touches(poses, speed, body, places, touched):
    """Write to [2,N] which motions touch a place, and which do within LAST_LOOK steps."""
    count, steps = speed.shape
    for n in range(count):
        for i in range(steps):
            x, y = poses[n, i, 0], poses[n, i, 1]
            cos, sin, v = poses[n, i, 2], poses[n, i, 3], speed[n, i]
            if v < MOVES:
                continue
            most = v * LAST_LOOK * FRAME_S
            for p in range(len(places)):
                dx, dy = places[p, 0] - x, places[p, 1] - y
                aside, ahead = abs(dy * cos - dx * sin), dx * cos + dy * sin - body[0]
                if aside > body[2] or ahead < -body[1] or ahead > body[1] + most:
                    continue
                touched[1, n] = 1.0
                if ahead <= body[1] and v > STOPPED:
                    touched[0, n] = 1.0
