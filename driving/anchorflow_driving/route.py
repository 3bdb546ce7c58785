"""A route: a polyline by its arc length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anchorflow_driving.geometry import out_of_frame

Array = NDArray[np.float64]

SPACING = 0.5
"""m between the points that a route is resampled to."""
SAME_POINT = 1e-6
"""m from its predecessor, up to which a point of a route is left out."""


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
        given = np.concatenate([[0.0], np.linalg.norm(np.diff(kept, axis=0), axis=1).cumsum()])
        count = max(2, int(np.ceil(given[-1] / SPACING)) + 1)
        self.arc_length = np.linspace(0.0, given[-1], count)
        self.points = np.stack([np.interp(self.arc_length, given, axis) for axis in kept.T], -1)
        self._edges = np.diff(self.points, axis=0)
        slope = np.gradient(self.points, self.arc_length, axis=0)
        self.heading = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
        self._tree = KDTree(self.points)

    @property
    def length(self) -> float:
        return float(self.arc_length[-1])

    def moved(self, frame: Array) -> Route:
        """The same route in the frame's parent, where it was given in the frame."""
        return Route(out_of_frame(self.points, frame))

    def project(self, points: Array) -> tuple[Array, Array]:
        """Arc length and distance to the left of the nearest place to points [..., 2]."""
        _, nearest = self._tree.query(points)
        # The foot lies on one of the two edges that meet at the nearest vertex.
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
