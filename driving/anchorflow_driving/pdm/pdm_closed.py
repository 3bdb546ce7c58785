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
from anchorflow_trajectory.car.following import LOOK_STRIDE, Leaders, drives_behind
from anchorflow_trajectory.car.tracking import STEPS, Motion, track
from anchorflow_trajectory.guard.motion import Car

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
    vehicle, start = traffic.vehicle, traffic.start
    half, axle = vehicle.length / 2, vehicle.rear_axle
    return drives_behind(
        traffic.route,
        _leaders(traffic),
        Car(front=axle + half, rear=half - axle, side=vehicle.width / 2),
        pose=start.pose,
        speed=start.speed,
        speed_limit=traffic.speed_limit,
    )


def _leaders(traffic: Traffic) -> Leaders:
    """Return the others in the route's own coordinates."""
    others, route = traffic.others, traffic.route
    states = others.states[:, : STEPS + 1 : LOOK_STRIDE]
    corners = box_corners(states[..., :3], others.size[:, None])
    along, left = route.project(np.concatenate([corners, states[..., None, :2]], axis=-2))
    heading = np.interp(along[..., -1], route.arc_length, route.heading)
    return Leaders(
        tail=along.min(-1),
        head=along.max(-1),
        right=left.min(-1),
        left=left.max(-1),
        middle=left[..., -1],
        reach=np.hypot(*others.size.T) / 2,
        speed=states[..., 3] * np.cos(heading) + states[..., 4] * np.sin(heading),
    )


def _emergency_brake(traffic: Traffic) -> Array:
    """[41, 3] straight ahead to a halt."""
    speed = traffic.start.speed
    time = np.minimum(np.arange(STEPS + 1) * FRAME_S, speed / EMERGENCY_BRAKING)
    distance = speed * time - EMERGENCY_BRAKING / 2 * time**2
    ahead = np.stack([distance, 0 * time, 0 * time], axis=-1)
    return out_of_frame(ahead, traffic.start.pose)
