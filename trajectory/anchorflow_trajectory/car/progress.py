"""How far a drive moves on along a course, step by step, and whether it follows it."""

from __future__ import annotations

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.compiled import compiled, compiled_part

BESIDE, FAR_BESIDE = 4.0, 8.0
"""m beside a course up to which a car follows it, as in the next lane, and from which on it does
not."""
TURNED = 0.35
"""Cosine of the angle to a course down to which a car follows it."""
SEARCH = 10
"""Points of a course ahead that the nearest is looked for among: 5 m."""


def progress(course: Course, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the m [P] by which poses [P,T,3] move on along a course, and how far [P] they follow
    it: 1 on the course, 0 at the end of those that have left it, whose m do not count either.

    Where a course comes back to itself, a car does not jump from one arm to the other.
    """
    way, follows = np.empty(len(poses)), np.empty(len(poses))
    line = np.column_stack([course.points, course.heading])
    begin = int(course.nearest(poses[0, 0, :2]))
    _progress(line, course.arc_length[1], np.ascontiguousarray(poses), begin, way, follows)
    return way, follows


@compiled
def _progress(
    line: FloatArray,
    spacing: float,
    poses: FloatArray,
    begin: int,
    way: FloatArray,
    follows: FloatArray,
) -> None:
    """Write to way [P] how far poses [P,T,3] move on along a line [M,3] of x, y and heading, and to
    follows [P] how far they are on it at their end."""
    for n in range(len(poses)):
        i = _nearest(line, begin, poses[n, 0])
        start, _, _ = _beside(line, spacing, i, poses[n, 0])
        for t in range(1, poses.shape[1]):
            i = _nearest(line, i, poses[n, t])
        along, aside, turned = _beside(line, spacing, i, poses[n, -1])
        beside = (FAR_BESIDE - aside) / (FAR_BESIDE - BESIDE)
        follows[n] = min(max(beside, 0.0), 1.0) * min(max(turned / TURNED, 0.0), 1.0)
        way[n] = max(along - start, 0.0) * follows[n]


@compiled_part
def _nearest(line: FloatArray, i: int, pose: FloatArray) -> int:
    """Return which point of a line is nearest to a pose, from shortly before the i-th on."""
    best, at = np.inf, i
    for j in range(max(i - 2, 0), min(i + SEARCH, len(line) - 1) + 1):
        away = (line[j, 0] - pose[0]) ** 2 + (line[j, 1] - pose[1]) ** 2
        if away < best:
            best, at = away, j
    return at


@compiled_part
def _beside(
    line: FloatArray, spacing: float, i: int, pose: FloatArray
) -> tuple[float, float, float]:
    """Return how far along a line, m, how far beside it, m, and how much turned to it, as a cosine,
    a pose is near the i-th point."""
    cos, sin = np.cos(line[i, 2]), np.sin(line[i, 2])
    dx, dy = pose[0] - line[i, 0], pose[1] - line[i, 1]
    turned = np.cos(pose[2]) * cos + np.sin(pose[2]) * sin
    return i * spacing + dx * cos + dy * sin, abs(dy * cos - dx * sin), turned
