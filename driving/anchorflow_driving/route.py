"""Routes and driven lines: polylines by arc length, smoothed, extended and blended."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import KDTree

from anchorflow_driving.geometry import Array, arc_lengths, at_places, out_of_frame

ROUTE_SPACING = 0.5
"""m between the points that a route is resampled to."""
SAME_POINT = 1e-6
"""m from its predecessor, up to which a point of a route is left out."""
SPACING = 0.25
"""m between the points of a line."""
LINE_SIGMA, ROUTE_SIGMA = 1.3, 1.5
"""m, of the Gaussians over driven lines and over centrelines."""
BLEND = 12.0
"""m before and after a change of lanes that the route takes for it."""
SIDESTEP = 1.0
"""m between two frames that only a change of lanes explains, beyond what was driven."""


def without_repeats(polyline: Array) -> Array:
    """The points of a polyline [V, 2] that differ from their predecessors."""
    gaps = np.linalg.norm(np.diff(polyline, axis=0), axis=1)
    return polyline[np.concatenate([[True], gaps > SAME_POINT])]


class Route:
    """Points and headings along a polyline [V, 2], two of which differ.

    points: [M, 2], evenly spaced
    arc_length: [M] m
    heading: [M] rad, unwrapped
    """

    def __init__(self, polyline: Array) -> None:
        kept = without_repeats(polyline)
        given = arc_lengths(kept)
        count = max(2, int(np.ceil(given[-1] / ROUTE_SPACING)) + 1)
        self.arc_length = np.linspace(0.0, given[-1], count)
        self.points = at_places(self.arc_length, given, kept)
        self._edges = np.diff(self.points, axis=0)
        slope = np.gradient(self.points, self.arc_length, axis=0)
        self.heading = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
        self._tree = KDTree(self.points)

    @property
    def length(self) -> float:
        return float(self.arc_length[-1])

    def moved(self, frame: Array) -> Route:
        """Return the route in the frame's parent, if it was given in the frame."""
        return Route(out_of_frame(self.points, frame))

    def project(self, points: Array) -> tuple[Array, Array]:
        """Arc length and distance to the left of the nearest place to points [..., 2]."""
        _, nearest = self._tree.query(points)
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

    def poses(self, arc_length: Array, left: Array | float = 0.0) -> Array:
        """Poses [..., 3] at arc lengths, so far to the left; straight on beyond either end."""
        beyond = arc_length - np.clip(arc_length, 0.0, self.length)
        heading = np.interp(arc_length, self.arc_length, self.heading)
        x, y = (np.interp(arc_length, self.arc_length, axis) for axis in self.points.T)
        cos, sin = np.cos(heading), np.sin(heading)
        return np.stack([x + beyond * cos - left * sin, y + beyond * sin + left * cos, heading], -1)


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
