"""Poses, boxes and polygons in the plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.car.course import arc_lengths as arc_lengths, at_places as at_places
from anchorflow_trajectory.car.tracking import wrap_angle as wrap_angle

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]

# Front left, front right, rear right, rear left, in half lengths and half widths.
_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])


def out_of_frame(points: Array, frame: Array) -> Array:
    """Points [..., 2] or poses [..., 3] given in a frame (x, y, heading), in its parent's."""
    cos, sin = np.cos(frame[..., 2]), np.sin(frame[..., 2])
    x, y = points[..., 0], points[..., 1]
    moved = [frame[..., 0] + cos * x - sin * y, frame[..., 1] + sin * x + cos * y]
    return np.stack([*moved, *_headings(points, frame[..., 2])], axis=-1)


def into_frame(points: Array, frame: Array) -> Array:
    """Points [..., 2] or poses [..., 3], seen from a frame (x, y, heading) of the same parent.

    Headings are reduced by the frame's and not wrapped.
    """
    cos, sin = np.cos(frame[..., 2]), np.sin(frame[..., 2])
    x, y = points[..., 0] - frame[..., 0], points[..., 1] - frame[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x, *_headings(points, -frame[..., 2])], -1)


def states_into_frame(states: Array, frame: Array) -> Array:
    """States [..., 5] x, y, heading, vx, vy, seen from a frame (x, y, heading) of the same parent.

    The frame stands still: velocities are turned, no more.
    """
    turned = np.array([0.0, 0.0, 1.0]) * frame
    poses, velocities = states[..., :3], states[..., 3:]
    return np.concatenate([into_frame(poses, frame), into_frame(velocities, turned)], -1)


def ahead_of(poses: Array, distance: float | Array) -> Array:
    """Poses [..., 3] moved forward along their headings, m."""
    moved = poses.copy()
    moved[..., 0] += distance * np.cos(poses[..., 2])
    moved[..., 1] += distance * np.sin(poses[..., 2])
    return moved


def arc_ends(length: Array, turn: Array) -> Array:
    """Poses [..., 3] after arcs of a length (m) and a turn (rad) from the origin along x."""
    # Chord and direction of the arc; sinc holds where it is straight.
    chord = length * np.sinc(turn / 2 / np.pi)
    return np.stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn], axis=-1)


def box_corners(poses: Array, size: Array) -> Array:
    """Corners [..., 4, 2] of boxes with their middles at poses [..., 3]; size [..., 2]."""
    local = _CORNERS * (size[..., None, :] / 2)
    return out_of_frame(local, poses[..., None, :])


def boxes_overlap(poses: Array, size: Array, other_poses: Array, other_size: Array) -> Booleans:
    """Whether boxes touch: no side of either separates them.

    poses: [..., 3] of the middles; size: [..., 2] length, width; all broadcast
    """
    turn = other_poses[..., 2] - poses[..., 2]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    half, other_half = size / 2, other_size / 2
    return _within_sides(poses, half, other_poses, other_half, cos, sin) & _within_sides(
        other_poses, other_half, poses, half, cos, sin
    )


def points_in_polygon(points: Array, polygon: Array) -> Booleans:
    """Which points [M, 2] lie inside a polygon [V, 2], by the number of edges to their right."""
    x, y = points[:, :1], points[:, 1:]
    x0, y0 = polygon.T
    x1, y1 = np.roll(polygon, -1, axis=0).T
    crosses = (y0 > y) != (y1 > y)
    rise = np.where(y0 == y1, 1.0, y1 - y0)
    right = x < x0 + (y - y0) * ((x1 - x0) / rise)
    return ((crosses & right).sum(axis=1) % 2).astype(bool)


def _headings(points: Array, turn: Array) -> list[Array]:
    return [points[..., 2] + turn] if points.shape[-1] == 3 else []


def _within_sides(
    poses: Array, half: Array, other_poses: Array, other_half: Array, cos: Array, sin: Array
) -> Booleans:
    """Whether the other box reaches between both pairs of parallel sides of a box."""
    offset = into_frame(other_poses[..., :2], poses)
    length, width = other_half[..., 0], other_half[..., 1]
    along = np.abs(offset[..., 0]) <= half[..., 0] + length * cos + width * sin
    across = np.abs(offset[..., 1]) <= half[..., 1] + length * sin + width * cos
    return along & across
