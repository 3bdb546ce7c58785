"""Courses: polylines by arc length, to be driven along."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.car.tracking import Array

COURSE_SPACING = 0.5
"""m between the points that a course is resampled to."""
SAME_POINT = 1e-6
"""m from its predecessor, up to which a point is left out."""
Real = NDArray[np.floating] | NDArray[np.integer]


def without_repeats(polyline: FloatArray) -> Array:
    """The points of a polyline [V, 2] that differ from their predecessors."""
    gaps = np.linalg.norm(np.diff(polyline, axis=0), axis=1)
    return np.asarray(polyline[np.concatenate([[True], gaps > SAME_POINT])], np.float64)


def arc_lengths(line: Array) -> Array:
    """Return the arc length [V] m at each point of a polyline [V, 2]."""
    return np.concatenate([[0.0], np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum()])


def at_places(places: Real, marks: Real, line: Real) -> Array:
    """Interpolate the columns of a line [V, D], known at marks [V], at places [...]."""
    return np.stack([np.interp(places, marks, axis) for axis in line.T], -1)


class Course:
    """Points and headings along a polyline [V, 2], two of which differ.

    points: [M, 2], evenly spaced
    arc_length: [M] m
    heading: [M] rad, unwrapped
    """

    def __init__(self, polyline: FloatArray) -> None:
        kept = without_repeats(polyline)
        given = arc_lengths(kept)
        count = max(2, int(np.ceil(given[-1] / COURSE_SPACING)) + 1)
        self.arc_length = np.linspace(0.0, given[-1], count)
        self.points = at_places(self.arc_length, given, kept)
        self._edges = np.diff(self.points, axis=0)
        slope = np.gradient(self.points, self.arc_length, axis=0)
        self.heading = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))

    @property
    def length(self) -> float:
        return float(self.arc_length[-1])

    def project(self, points: FloatArray) -> tuple[Array, Array]:
        """Arc length and distance to the left of the nearest place to points [..., 2]."""
        nearest = self.nearest(points)
        # The foot is on one of the two edges that meet at the nearest vertex.
        edge = np.clip(np.stack([nearest - 1, nearest], -1), 0, len(self._edges) - 1)
        along, start = self._edges[edge], self.points[edge]
        length = np.linalg.norm(along, axis=-1)
        offset = points[..., None, :] - start
        share = np.clip((offset * along).sum(-1) / length**2, 0.0, 1.0)
        miss = offset - share[..., None] * along
        distance = np.linalg.norm(miss, axis=-1)
        left = np.sign(along[..., 0] * miss[..., 1] - along[..., 1] * miss[..., 0])
        best = distance.argmin(-1)[..., None]
        arc_length = self.arc_length[edge] + share * length
        return (
            np.take_along_axis(arc_length, best, -1)[..., 0],
            np.take_along_axis(left * distance, best, -1)[..., 0],
        )

    def nearest(self, points: FloatArray) -> NDArray[np.intp]:
        """Return which of the course's points [M, 2] is nearest to each of `points` [..., 2]."""
        # The nearest has the largest p·q - q²/2: one product in place of all differences.
        line = self.points - self.points[0]
        return ((points - self.points[0]) @ line.T - 0.5 * (line * line).sum(-1)).argmax(-1)

    def poses(self, arc_length: Array, left: Array | float = 0.0) -> Array:
        """Poses [..., 3] at arc lengths, so far to the left; straight on beyond either end."""
        beyond = arc_length - np.clip(arc_length, 0.0, self.length)
        heading = np.interp(arc_length, self.arc_length, self.heading)
        x, y = (np.interp(arc_length, self.arc_length, axis) for axis in self.points.T)
        cos, sin = np.cos(heading), np.sin(heading)
        return np.stack([x + beyond * cos - left * sin, y + beyond * sin + left * cos, heading], -1)
