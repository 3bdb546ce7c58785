"""Drives along a course at constant accelerations, slower in bends: candidates of a car with a
route."""

from __future__ import annotations

import numpy as np

from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.tracking import FRAME_S, STEPS, Array, wrap_angle

RATES = (1.5, 0.75, 0.0, -0.75, -1.5, -2.5, -4.0, -6.0)
"""m/s²."""
OFFSETS = (0.0, -1.0, 1.0)
"""m to the left of the course."""
IN_BENDS = 2.0
"""m/s²: sideways in bends, and of braking before them."""
JOIN_M, JOIN_S = 8.0, 1.5
"""The way on which a car joins its path: metres, or seconds at its speed if that is longer."""
STRIDE = 5
"""Steps between two poses of a plan."""
HALF_BEND = 2.0
"""m before and after a place that its bend is measured between."""
STRAIGHT = 1e-3
"""1/m; bends below it limit no speed."""
NUDGE = 1e-2
"""m between two places that give the slope of a path."""


def route_drives(
    course: Course, speed: float, *, top_speed: float, offsets: tuple[float, ...] = OFFSETS
) -> Array:
    """Return drives [K,8,3] at 0.5 … 4.0 s of a car at the origin: each path times each rate.

    A drive keeps its rate until it stands or has the top speed (m/s), or one that fits a bend.
    """
    start, left = (float(value) for value in course.project(np.zeros(2)))
    way = _ways(course, start, speed, max(top_speed, speed))[:, STRIDE::STRIDE]
    join = max(JOIN_M, JOIN_S * speed)
    drives = []
    for offset in offsets:
        aside, further = (
            left + (offset - left) * _smooth(each / join) for each in (way, way + NUDGE)
        )
        poses = course.poses(start + way, aside)
        poses[..., 2] = wrap_angle(poses[..., 2] + np.arctan2(further - aside, NUDGE))
        drives.append(poses)
    return np.concatenate(drives)


def _ways(course: Course, start: float, speed: float, top_speed: float) -> Array:
    """Return the m [R,41] driven at each rate from a place (m) on."""
    marks, heading = course.arc_length, course.heading
    before, after = (np.interp(marks + away, marks, heading) for away in (-HALF_BEND, HALF_BEND))
    bend = np.abs(after - before) / (2 * HALF_BEND)
    fits = np.minimum(np.sqrt(IN_BENDS / np.maximum(bend, STRAIGHT)), top_speed)
    spacing = marks[1]
    for index in range(len(fits) - 2, -1, -1):
        fits[index] = min(fits[index], np.sqrt(fits[index + 1] ** 2 + 2 * IN_BENDS * spacing))
    rates = np.array(RATES)
    way, speeds = np.zeros((len(rates), STEPS + 1)), np.full(len(rates), speed)
    for step in range(STEPS):
        most = np.interp(start + way[:, step], marks, fits)
        wanted = speeds + rates * FRAME_S
        slower = np.maximum(np.minimum(wanted, speeds - IN_BENDS * FRAME_S), most)
        speeds = np.maximum(np.where(wanted > most, slower, wanted), 0.0)
        way[:, step + 1] = way[:, step] + speeds * FRAME_S
    return way


def _smooth(share: Array) -> Array:
    """Return the cubic from 0 to 1 that is level at both ends."""
    share = share.clip(0.0, 1.0)
    return share * share * (3 - 2 * share)
