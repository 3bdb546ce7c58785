"""The compiled test of motions: on the road, clear of boxes at constant velocity, and of occupancy.

Rasters are seen from above, row 0 at the greatest x, column 0 at the greatest y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.guard.motion import FINE_S, Car, FineMotion

NONE, ROAD, BOX, TAKEN = range(4)
"""What is wrong with a motion: nothing; off the road; hits a box; where occupancy is foretold."""
HALF = 0.5
"""Share of a cell from which on it counts as road, or as taken."""

GROWING_S = 1.5
"""s for which a box grows whose speed is not known better."""


@dataclass(frozen=True, eq=False)
class Raster:
    """What is known of places by cells.

    values: [L,H,W] float32 in [0, 1]; extent: least and greatest x, least and greatest y in m
    first_s, step_s: s from now to the first of the L layers, and from one to the next
    """

    values: NDArray[np.float32]
    extent: tuple[float, float, float, float]
    first_s: float = 0.0
    step_s: float = 1.0

    @property
    def cell(self) -> float:
        """m a side."""
        return (self.extent[1] - self.extent[0]) / self.values.shape[1]

    @property
    def frame(self) -> FloatArray:
        """[5]: greatest x and y, cell in m, first_s, step_s."""
        return np.array(
            [self.extent[1], self.extent[3], self.cell, self.first_s, self.step_s], np.float64
        )


@dataclass(frozen=True, eq=False)
class Perceived:
    """What a planner perceives, in the frame of the rear axle now.

    road: one layer, how sure each cell is road
    boxes: [K,8] x, y, heading of the middle; half length, half width in m; velocity x, y in m/s;
        m/s by which the half length grows, of one whose speed is not known better
    taken: the share of each cell that others take, by time
    """

    road: Raster
    boxes: FloatArray
    taken: Raster


def first_faults(
    motion: FineMotion, car: Car, perceived: Perceived, *, horizon_s: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return what is wrong with each of N motions [N], and the index [N] of the first such time.

    Until `horizon_s` everything counts. Later a box that comes from behind does not, nor what the
    rasters do not show: this is when the car brakes.
    """
    faults = np.zeros((2, len(motion.poses)), np.int64)
    faults[1] = len(motion.times)
    road = np.ascontiguousarray(perceived.road.values[0], np.float32)
    high = road >= HALF
    _first_faults(
        np.ascontiguousarray(motion.poses),
        np.ascontiguousarray(motion.along),
        np.ascontiguousarray(motion.across),
        np.array([car.middle, car.half_length, car.side]),
        int(np.floor(horizon_s / FINE_S + 1e-6)),
        _within_reach(perceived.boxes, motion, car),
        road,
        high[1:, 1:] & high[1:, :-1] & high[:-1, 1:] & high[:-1, :-1],
        perceived.road.frame,
        np.ascontiguousarray(perceived.taken.values, np.float32),
        perceived.taken.frame,
        faults,
    )
    return faults[0], faults[1]


def _within_reach(boxes: FloatArray, motion: FineMotion, car: Car) -> FloatArray:
    """Return the boxes [K,9] that motions may meet, grown by what they move within half a step:
    x, y, velocity x, y, half length, half width, cos, sin, growth in m/s."""
    x, y, heading, length, width, vx, vy, growth = boxes.T
    cos, sin = np.cos(heading), np.sin(heading)
    length = length + FINE_S / 2 * (np.abs(vx * cos + vy * sin) + growth)
    width = width + FINE_S / 2 * np.abs(vy * cos - vx * sin)
    far = np.hypot(motion.poses[..., 0], motion.poses[..., 1]) + motion.along + motion.across
    covered = far.max() + car.middle + car.half_length + car.side + length + width
    covered += motion.times[-1] * (np.hypot(vx, vy) + growth)
    grown = np.stack([x, y, vx, vy, length, width, cos, sin, growth], -1)
    return np.ascontiguousarray(grown[np.hypot(x, y) <= covered])


@compiled
def _first_faults(
    poses, along, across, body, strict, boxes, road, solid, road_frame, taken, taken_frame, faults
):
    """Write the kind and the time of the first fault of each motion to [2,N]."""
    count, steps = poses.shape[:2]
    near, place = np.empty(len(boxes), np.int64), np.empty(6)
    for i in range(steps):
        now, is_strict = FINE_S * i, i <= strict
        few = _near(poses, along, across, body, faults, boxes, i, near)
        for n in range(count):
            if faults[0, n] != NONE:
                continue
            cos, sin = np.cos(poses[n, i, 2]), np.sin(poses[n, i, 2])
            place[0], place[1] = poses[n, i, 0] + body[0] * cos, poses[n, i, 1] + body[0] * sin
            place[2], place[3] = cos, sin
            place[4], place[5] = body[1] + along[n, i], body[2] + across[n, i]
            fault = NONE
            if not _on_road(place, road, solid, road_frame, is_strict):
                fault = ROAD
            elif _hits(place, boxes, near[:few], now, poses[n, strict], body, strict):
                fault = BOX
            elif is_strict and _is_taken(place, taken, taken_frame, now):
                fault = TAKEN
            if fault != NONE:
                faults[0, n], faults[1, n] = fault, i


@compiled_part
def _near(poses, along, across, body, faults, boxes, i, near):
    """Write which boxes are near to any motion at a time; return how many."""
    x_low, x_high, y_low, y_high, reach = np.inf, -np.inf, np.inf, -np.inf, 0.0
    for n in range(poses.shape[0]):
        if faults[0, n] == NONE:
            x_low, x_high = min(x_low, poses[n, i, 0]), max(x_high, poses[n, i, 0])
            y_low, y_high = min(y_low, poses[n, i, 1]), max(y_high, poses[n, i, 1])
            reach = max(reach, along[n, i] + across[n, i])
    reach += abs(body[0]) + body[1] + body[2]
    few = 0
    for k in range(len(boxes)):
        size = reach + boxes[k, 4] + boxes[k, 5] + boxes[k, 8] * GROWING_S
        x, y = boxes[k, 0] + boxes[k, 2] * FINE_S * i, boxes[k, 1] + boxes[k, 3] * FINE_S * i
        if x_low - size <= x <= x_high + size and y_low - size <= y <= y_high + size:
            near[few] = k
            few += 1
    return few


@compiled_part
def _on_road(place, road, solid, frame, is_strict):
    """Whether both sides of a box stay on the road, at points a cell apart or nearer: in their
    cell, and between the cells about them."""
    x, y, cos, sin, half, side = place[0], place[1], place[2], place[3], place[4], place[5]
    rows, columns = road.shape
    count = int(np.ceil(2 * half / frame[2]))
    # A point every `stride` cells from the rear to the front, on either side.
    stride = 2 * half / (count * frame[2])
    for turn in (-side, side):
        rear_row = (frame[0] - x + half * cos + turn * sin) / frame[2] - 0.5
        rear_column = (frame[1] - y + half * sin - turn * cos) / frame[2] - 0.5
        for k in range(count + 1):
            row, column = rear_row - k * stride * cos, rear_column - k * stride * sin
            if row >= rows - 1:
                continue  # behind the raster: where the car comes from
            if row < 0 or column < 0 or column >= columns - 1:
                if is_strict:
                    return False
                continue
            if solid[int(row), int(column)]:
                continue
            if road[int(row + 0.5), int(column + 0.5)] < HALF:
                return False
            i, j = int(row), int(column)
            down, right = row - i, column - j
            upper = (1 - right) * road[i, j] + right * road[i, j + 1]
            lower = (1 - right) * road[i + 1, j] + right * road[i + 1, j + 1]
            if (1 - down) * upper + down * lower < HALF:
                return False
    return True


@compiled_part
def _hits(place, boxes, near, now, before, body, strict):
    """Whether a box touches one of the others; after the horizon, one that was not behind then.

    before: [3] pose at the horizon
    """
    horizon_s = FINE_S * strict
    x, y, cos, sin, half, side = place[0], place[1], place[2], place[3], place[4], place[5]
    for k in near:
        dx, dy = boxes[k, 0] + boxes[k, 2] * now - x, boxes[k, 1] + boxes[k, 3] * now - y
        length, width = boxes[k, 4] + boxes[k, 8] * min(now, GROWING_S), boxes[k, 5]
        reach = half + side + length + width
        if dx * dx + dy * dy > reach * reach:
            continue
        c, s = boxes[k, 6], boxes[k, 7]
        ahead, aside = dx * cos + dy * sin, dy * cos - dx * sin
        if now > horizon_s + 0.5 * FINE_S:
            bx, by = boxes[k, 0] + boxes[k, 2] * horizon_s, boxes[k, 1] + boxes[k, 3] * horizon_s
            was = (bx - before[0]) * np.cos(before[2]) + (by - before[1]) * np.sin(before[2])
            if was < body[0] - body[1]:
                continue
        turned, tilted = abs(c * cos + s * sin), abs(s * cos - c * sin)
        if abs(ahead) > half + length * turned + width * tilted:
            continue
        if abs(aside) > side + length * tilted + width * turned:
            continue
        if abs(dx * c + dy * s) > length + half * turned + side * tilted:
            continue
        if abs(dy * c - dx * s) > width + half * tilted + side * turned:
            continue
        return True
    return False


@compiled_part
def _is_taken(place, taken, frame, now):
    """Whether a cell under the outline or the middle line of a box is taken, in the layer before
    now or the one after."""
    x, y, cos, sin, half, side = place[0], place[1], place[2], place[3], place[4], place[5]
    layers, rows, columns = taken.shape
    before = int(np.floor((now - frame[3]) / frame[4]))
    after = min(max(before + 1, 0), layers - 1)
    before = min(max(before, 0), layers - 1)
    count = int(np.ceil(2 * half / frame[2])) + 1
    for k in range(count):
        ahead = -half + 2 * half * k / (count - 1)
        for aside in (-side, 0.0, side):
            row = int(np.floor((frame[0] - x - ahead * cos + aside * sin) / frame[2]))
            column = int(np.floor((frame[1] - y - ahead * sin - aside * cos) / frame[2]))
            if row < 0 or column < 0 or row >= rows or column >= columns:
                continue
            if taken[before, row, column] >= HALF or taken[after, row, column] >= HALF:
                return True
    return False
