"""Careful drives along a course, among others who are foreseen: candidates, and a reference.

Both are the drives of PDM-Closed (`following`): behind leaders who keep their velocities, and
behind those who go their likeliest way. The reference is what PDM-Closed would choose of the
former, by whose progress the PDM score measures that of others.
"""

from __future__ import annotations

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.following import (
    LOOK_STRIDE,
    OFFSETS,
    UNKNOWN_SPEED_LIMIT,
    Leaders,
    drives_behind,
)
from anchorflow_trajectory.car.foresight import Driven, Foreseen
from anchorflow_trajectory.car.tracking import FRAME_S, STEPS, EgoState
from anchorflow_trajectory.guard.motion import Car

FREE_PROGRESS = 0.1
"""m: among careful drives, nearly every metre counts."""
HALF_PLACE = 0.25
"""m, half of a place that something stands at."""
STRIDE = 5
"""Steps between two poses of a plan."""
SHORTEST_LEG = 0.3
"""m between two poses of a plan, up to which the later one says nothing of its course."""
BEFORE_M, BEYOND_M = 3.0, 60.0
"""m by which a presumed course begins before the car and goes on after its plan."""


def careful_drives(course: Course, start: EgoState, car: Car, foreseen: Foreseen) -> FloatArray:
    """Return drives [15,8,3] at 0.5 … 4.0 s after the start, behind others in their likeliest
    modes."""
    leaders = _leaders(course, car, foreseen)
    drives = drives_behind(
        course,
        leaders,
        car,
        pose=start.pose,
        speed=start.speed,
        speed_limit=UNKNOWN_SPEED_LIMIT,
    )
    return drives[:, STRIDE::STRIDE]


def reference_progress(drives: Driven, seen: Foreseen) -> float:
    """Return the m of progress of the drive that is best if everybody keeps his velocity."""
    found = drives.among(seen)
    quality = found.quality(float((found.way * found.kept).max()), free=FREE_PROGRESS)
    return float(found.way[(found.kept * quality).argmax()])


def presumed_course(plans: FloatArray, scores: FloatArray, start: EgoState) -> Course:
    """Return the course of a car that is told no route: that of the plan [N,8,3] with the most
    score [N] times length, and straight on from its end.
    """
    poses = np.concatenate([np.tile(start.pose, (len(plans), 1, 1)), plans], 1)
    legs = np.linalg.norm(np.diff(poses[..., :2], axis=1), axis=-1)
    best = int((scores * legs.sum(1)).argmax())
    line = poses[best][np.concatenate([[True], legs[best] > SHORTEST_LEG])]
    ahead = np.array([np.cos(line[-1, 2]), np.sin(line[-1, 2])])
    behind = np.array([np.cos(start.pose[2]), np.sin(start.pose[2])])
    line = line[:, :2]
    return Course(
        np.concatenate([line[:1] - BEFORE_M * behind, line, line[-1:] + BEYOND_M * ahead])
    )


def _leaders(course: Course, car: Car, foreseen: Foreseen) -> Leaders:
    """Return the others in their likeliest modes, and what stands near the course."""
    likeliest = foreseen.probabilities.argmax(1)
    driven = foreseen.poses[np.arange(len(likeliest)), likeliest]
    velocity = np.gradient(driven[..., :2], FRAME_S, axis=1)[:, : STEPS + 1 : LOOK_STRIDE]
    driven = driven[:, : STEPS + 1 : LOOK_STRIDE]
    along, left = course.project(driven[..., :2])
    heading = np.interp(along, course.arc_length, course.heading)
    turned, half = driven[..., 2] - heading, foreseen.half
    speed = velocity[..., 0] * np.cos(heading) + velocity[..., 1] * np.sin(heading)
    if len(foreseen.standing):
        places = np.stack(course.project(foreseen.standing), 1)
        beside = max(OFFSETS) + car.side + 2 * HALF_PLACE
        places = places[np.abs(places[:, 1]) <= beside]
        always = np.ones((1, driven.shape[1]))
        along = np.concatenate([along, places[:, :1] * always])
        left = np.concatenate([left, places[:, 1:] * always])
        heading = np.interp(places[:, :1], course.arc_length, course.heading)
        turned = np.concatenate([turned, -heading * always])
        half = np.concatenate([half, np.full((len(places), 2), HALF_PLACE)])
        speed = np.concatenate([speed, np.zeros((len(places), driven.shape[1]))])
    cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    ahead, aside = half[:, :1] * cos + half[:, 1:] * sin, half[:, :1] * sin + half[:, 1:] * cos
    return Leaders(
        tail=along - ahead,
        head=along + ahead,
        right=left - aside,
        left=left + aside,
        middle=left,
        reach=np.hypot(*half.T),
        speed=speed,
    )
