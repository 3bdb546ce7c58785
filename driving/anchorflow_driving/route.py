"""Routes and driven lines: polylines by arc length, smoothed, extended and blended."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import KDTree

from anchorflow_driving.geometry import Array, arc_lengths, at_places, out_of_frame
from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.car.course import Course

SPACING = 0.25
"""m between the points of a line."""
LINE_SIGMA, ROUTE_SIGMA = 1.3, 1.5
"""m, of the Gaussians over driven lines and over centrelines."""
BLEND = 12.0
"""m before and after a change of lanes that the route takes for it."""
SIDESTEP = 1.0
"""m between two frames that only a change of lanes explains, beyond what was driven."""


class Route(Course):
    """A course that is projected onto often, at any length."""

    def __init__(self, polyline: Array) -> None:
        super().__init__(polyline)
        self._tree = KDTree(self.points)

    def nearest(self, points: FloatArray) -> NDArray[np.intp]:
        """Return which of the route's points [M, 2] is nearest to each of `points` [..., 2]."""
        _, nearest = self._tree.query(points)
        return np.asarray(nearest)

    def moved(self, frame: Array) -> Route:
        """Return the route in the frame's parent, if it was given in the frame."""
        return Route(out_of_frame(self.points, frame))


def smooth_line(points: Array, *, before: float = 0.0, sigma: float = LINE_SIGMA) -> Array:
    """A polyline every SPACING m, smoothed by a Gaussian; it begins `before` m ahead of its first.

    before: a multiple of SPACING

    Its ends are led on straight, so that they stay where they are.
    """
    if len(points) < 2:
        points = np.concatenate([points, points + np.array([1e-3, 0.0])])
    lead = SPACING * np.ceil((before + 4 * sigma) / SPACING)
    first = points[0] - (points[min(3, len(points) - 1)] - points[0])
    towards = _unit(points[0] - first)
    backwards, onwards = -towards, _unit(points[-1] - points[-2])
    line = np.concatenate(
        [points[:1] + lead * backwards, points, points[-1:] + 4 * sigma * onwards]
    )
    length = arc_lengths(line)
    even = at_places(np.arange(0.0, length[-1], SPACING), length, line)
    smoothed = gaussian_filter1d(even, sigma / SPACING, axis=0, mode="nearest")
    return smoothed[round((lead - before) / SPACING) :]


def blended(points: Array, driven: Array) -> Array:
    """A line without the points around sideways steps, so that it goes over gradually.

    points: [V, 2]; the first F belong to the driven positions [F, 2]
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    recorded = len(driven)
    moved = np.linalg.norm(np.diff(driven, axis=0), axis=1)
    allowed = np.full(len(steps), np.inf)
    allowed[: recorded - 1] = moved + SIDESTEP
    kept = np.ones(len(points), bool)
    length = np.concatenate([[0.0], np.minimum(steps, allowed).cumsum()])
    for jump in np.flatnonzero(steps > allowed):
        kept &= np.abs(length - length[jump]) > BLEND
    kept[[0, -1]] = True
    return points[kept & np.append(True, steps > 1e-3)]


def places_on(line: Array, points: Array) -> Array:
    """Where on a line of SPACING each of some points lies, m.

    Never backwards, so that a line which crosses itself cannot mislead.
    """
    place, places = 0, []
    for point in points:
        # Within what a vehicle may drive in a frame, and some.
        near = line[place : place + 40]
        place += int(np.linalg.norm(near - point, axis=1).argmin())
        places.append(place * SPACING)
    return np.array(places)


def _unit(step: Array) -> Array:
    return step / max(float(np.hypot(*step)), 1e-9)
