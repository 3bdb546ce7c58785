"""PDM-Closed (Dauner et al., 2023, arXiv:2306.07962): the best of 15 IDM drives along the route.

Three paths, on the route and 1 m to either side, times five target speeds; each is tracked and
scored among others that keep their velocities, and the best is driven.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_driving.geometry import Array, box_corners, into_frame, out_of_frame
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.pdm.sub_scores import rate
from anchorflow_driving.pdm.traffic import Traffic
from anchorflow_trajectory.car.tracking import STEPS, Motion, track

OFFSETS = (0.0, -1.0, 1.0)  # m to the left
SPEED_SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)  # of the speed limit
GAP, HEADWAY = 1.0, 1.5  # m, s
ACCELERATION, DECELERATION = 1.5, 3.0  # m/s²
EXPONENT = 10
HARDEST_BRAKING = 8.0  # m/s²
SMALLEST_GAP = 0.1  # m
PREDICTION_STRIDE = 2
"""Steps between two looks for a leader."""
EMERGENCY_WITHIN_S, EMERGENCY_BELOW = 2.0, 5.0  # s, m/s
EMERGENCY_BRAKING = 4.0  # m/s²
FREE_PROGRESS = 0.1
"""m: among proposals, nearly every metre counts."""


@dataclass(frozen=True)
class PdmClosed:
    """The chosen drive."""

    poses: Array  # [41, 3] in the ego's frame, at 0 … 4.0 s
    motion: Motion  # P = 1, in the log's frame


def pdm_closed(traffic: Traffic) -> PdmClosed:
    """Drives in traffic whose others were predicted (`seen_traffic`, `Traffic.predicted`).

    Where even the best drive is at fault for a collision within two seconds and the ego is slow, it
    brakes straight ahead.
    """
    proposals = idm_proposals(traffic)
    wheelbase = traffic.vehicle.wheelbase
    motion = track(proposals, traffic.start, wheelbase=wheelbase)
    rating = rate(motion, traffic, free=FREE_PROGRESS)
    best = int(rating.scores.pdms.argmax())
    chosen, driven = proposals[best], motion[best : best + 1]
    collides = rating.first_fault[best] * FRAME_S <= EMERGENCY_WITHIN_S
    if collides and traffic.start.speed <= EMERGENCY_BELOW:
        chosen = _emergency_brake(traffic)
        driven = track(chosen[None], traffic.start, wheelbase=wheelbase)
    return PdmClosed(into_frame(chosen, traffic.start.pose), driven)


def idm_proposals(traffic: Traffic) -> Array:
    """[15, 41, 3] in the log's frame: the intelligent driver model behind the nearest leader."""
    offset = np.repeat(OFFSETS, len(SPEED_SHARES))
    wanted = np.tile(SPEED_SHARES, len(OFFSETS)) * traffic.speed_limit
    start, _ = traffic.route.project(traffic.start.pose[:2])
    lane = _Leaders(traffic)
    place = np.full(len(offset), float(start))
    speed = np.full(len(offset), traffic.start.speed)
    places = np.empty((len(offset), STEPS + 1))
    gap = leader_speed = np.zeros(0)
    for step in range(STEPS + 1):
        places[:, step] = place
        if step % PREDICTION_STRIDE == 0:
            gap, leader_speed = lane.ahead_of(place, offset, step)
        acceleration = idm_acceleration(speed, wanted, gap=gap, leader_speed=leader_speed)
        place = place + speed * FRAME_S
        gap = gap - (speed - leader_speed) * FRAME_S
        speed = np.maximum(0.0, speed + acceleration * FRAME_S)
    poses = traffic.route.poses(places, offset[:, None])
    poses[:, 0] = traffic.start.pose
    return poses


def idm_acceleration(speed: Array, wanted: Array, *, gap: Array, leader_speed: Array) -> Array:
    """Return IDM's acceleration, m/s² (Treiber, Hennecke and Helbing, 2000); no leader: gap inf."""
    closing = speed * (speed - leader_speed) / (2 * np.sqrt(ACCELERATION * DECELERATION))
    wanted_gap = GAP + np.maximum(0.0, speed * HEADWAY + closing)
    interaction = (wanted_gap / np.maximum(gap, SMALLEST_GAP)) ** 2
    free = 1 - (speed / wanted) ** EXPONENT
    return np.clip(ACCELERATION * (free - interaction), -HARDEST_BRAKING, ACCELERATION)


class _Leaders:
    """The others in the route's own coordinates: arc length and distance to the left."""

    def __init__(self, traffic: Traffic) -> None:
        self._vehicle, self._end = traffic.vehicle, traffic.route.length - 1e-6
        others, route = traffic.others, traffic.route
        states = others.states[:, : STEPS + 1 : PREDICTION_STRIDE]
        corners = box_corners(states[..., :3], others.size[:, None])
        along, left = route.project(np.concatenate([corners, states[..., None, :2]], axis=-2))
        self._tail, self._head = along.min(-1), along.max(-1)
        self._right, self._left = left.min(-1), left.max(-1)
        # The corners of a box between two arms of a bent route may project on either: only a box
        # with its middle near the path can be on it.
        self._middle = left[..., -1]
        self._reach = np.hypot(*others.size.T) / 2
        heading = np.interp(along[..., -1], route.arc_length, route.heading)
        self._speed = states[..., 3] * np.cos(heading) + states[..., 4] * np.sin(heading)

    def ahead_of(self, place: Array, offset: Array, step: int) -> tuple[Array, Array]:
        """Return the gap (m, inf if free) and the leader's speed along the route, [P] each.

        place: [P] arc length of the rear axle; offset: [P] of the path, to the left
        """
        look, place, offset = step // PREDICTION_STRIDE, place[:, None], offset[:, None]
        half = self._vehicle.width / 2
        leads = (
            (self._left[:, look] >= offset - half)
            & (self._right[:, look] <= offset + half)
            & (np.abs(self._middle[:, look] - offset) <= half + self._reach)
            & (self._head[:, look] > place + self._vehicle.rear_axle)
            & (self._tail[:, look] < self._end)
        )
        nose = self._vehicle.rear_axle + self._vehicle.length / 2
        gap = np.where(leads, self._tail[:, look] - place - nose, np.inf)
        if not gap.shape[1]:
            return np.full(len(place), np.inf), np.zeros(len(place))
        nearest = gap.argmin(1)
        return gap[np.arange(len(gap)), nearest], self._speed[nearest, look]


def _emergency_brake(traffic: Traffic) -> Array:
    """[41, 3] straight ahead to a halt."""
    speed = traffic.start.speed
    time = np.minimum(np.arange(STEPS + 1) * FRAME_S, speed / EMERGENCY_BRAKING)
    distance = speed * time - EMERGENCY_BRAKING / 2 * time**2
    ahead = np.stack([distance, 0 * time, 0 * time], axis=-1)
    return out_of_frame(ahead, traffic.start.pose)
