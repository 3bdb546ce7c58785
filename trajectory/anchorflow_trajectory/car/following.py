"""Drives along a course behind whoever is ahead, by the intelligent driver model.

PDM-Closed (Dauner et al., 2023, arXiv:2306.07962) proposes such drives on paths on and beside the
route at shares of the speed limit. The driving score makes its reference of them, and GoalFlow
drives that it chooses among.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.tracking import FRAME_S, STEPS, Array
from anchorflow_trajectory.guard.motion import Car

OFFSETS = (0.0, -1.0, 1.0)  # m to the left
SPEED_SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)  # of the speed limit
UNKNOWN_SPEED_LIMIT = 15.0  # m/s
GAP, HEADWAY = 1.0, 1.5  # m, s
ACCELERATION, DECELERATION = 1.5, 3.0  # m/s²
EXPONENT = 10
HARDEST_BRAKING = 8.0  # m/s²
SMALLEST_GAP = 0.1  # m
LOOK_STRIDE = 2
"""Steps between two looks for a leader."""


@dataclass(frozen=True, eq=False)
class Leaders:
    """K others in a course's own coordinates, at L looks: m along it and to the left of it.

    tail, head, right, left: [K, L] least and greatest places of their boxes
    middle: [K, L] to the left, of the boxes' middles; reach: [K] m from there to the corners
    speed: [K, L] m/s along the course
    """

    tail: Array
    head: Array
    right: Array
    left: Array
    middle: Array
    reach: Array
    speed: Array

    def ahead_of(
        self, place: Array, offset: Array, look: int, car: Car, end: float
    ) -> tuple[Array, Array]:
        """Return the gap (m, inf if free) and the leader's speed along the course, [P] each.

        place: [P] arc length of the rear axle; offset: [P] of the path, to the left
        end: m, of the course, beyond which nobody leads
        """
        if not len(self.reach):
            return np.full(len(place), np.inf), np.zeros(len(place))
        place, offset = place[:, None], offset[:, None]
        # The corners of a box between two arms of a bent course may project on either: only a box
        # with its middle near the path can be on it.
        leads = (
            (self.left[:, look] >= offset - car.side)
            & (self.right[:, look] <= offset + car.side)
            & (np.abs(self.middle[:, look] - offset) <= car.side + self.reach)
            & (self.head[:, look] > place + car.middle)
            & (self.tail[:, look] < end)
        )
        gap = np.where(leads, self.tail[:, look] - place - car.front, np.inf)
        nearest = gap.argmin(1)
        return gap[np.arange(len(gap)), nearest], self.speed[nearest, look]


def drives_behind(
    course: Course, leaders: Leaders, car: Car, *, pose: Array, speed: float, speed_limit: float
) -> Array:
    """Return drives [15, 41, 3] at 0, 0.1, … 4.0 s: three paths times five speeds.

    pose: [3] of the rear axle now; speed, speed_limit: m/s
    """
    offset = np.repeat(OFFSETS, len(SPEED_SHARES))
    wanted = np.tile(SPEED_SHARES, len(OFFSETS)) * speed_limit
    start, _ = course.project(pose[:2])
    place, speeds = np.full(len(offset), float(start)), np.full(len(offset), speed)
    places = np.empty((len(offset), STEPS + 1))
    gap = leader_speed = np.zeros(0)
    for step in range(STEPS + 1):
        places[:, step] = place
        if step % LOOK_STRIDE == 0:
            look = step // LOOK_STRIDE
            gap, leader_speed = leaders.ahead_of(place, offset, look, car, course.length - 1e-6)
        acceleration = idm_acceleration(speeds, wanted, gap=gap, leader_speed=leader_speed)
        place = place + speeds * FRAME_S
        gap = gap - (speeds - leader_speed) * FRAME_S
        speeds = np.maximum(0.0, speeds + acceleration * FRAME_S)
    poses = course.poses(places, offset[:, None])
    poses[:, 0] = pose
    return poses


def idm_acceleration(speed: Array, wanted: Array, *, gap: Array, leader_speed: Array) -> Array:
    """Return IDM's acceleration, m/s² (Treiber, Hennecke and Helbing, 2000); no leader: gap inf."""
    closing = speed * (speed - leader_speed) / (2 * np.sqrt(ACCELERATION * DECELERATION))
    wanted_gap = GAP + np.maximum(0.0, speed * HEADWAY + closing)
    interaction = (wanted_gap / np.maximum(gap, SMALLEST_GAP)) ** 2
    free = 1 - (speed / wanted) ** EXPONENT
    return np.clip(ACCELERATION * (free - interaction), -HARDEST_BRAKING, ACCELERATION)
