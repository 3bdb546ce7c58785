"""The robot's body as discs, which are looked up in a distance field."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.robot import Robot

Array = NDArray[np.float64]

OVERHANG = 0.1  # of the body's half width, by which discs may stand out beyond a footprint
OUTLINE, CENTRES = 0.05, 0.1  # of the half width: between points of the outline, between centres
ROUNDING = 1e-9


def discs_of(robot: Robot) -> NDArray[np.float32]:
    """Return [J,3], x, y and radius in m of discs in the robot's frame that cover its outline.

    The outline is that of the convex hull, and discs stand out beyond it by OVERHANG at most. The
    largest come first.
    """
    if robot.radius is not None:
        return np.array([[0.0, 0.0, robot.radius]], np.float32)
    corners = np.asarray(robot.footprint, np.float64)
    half_width = _depth(_inside(corners, 0.02 * float(np.ptp(corners))), corners).max()
    outline = _outline(corners, OUTLINE * half_width)
    centres = np.concatenate([_inside(corners, CENTRES * half_width), outline])
    radii = np.maximum(_depth(centres, corners), 0.0) + OVERHANG * half_width
    covers = np.linalg.norm(outline[:, None] - centres, axis=-1) <= radii + ROUNDING
    chosen = _set_cover(covers)
    discs = np.column_stack([centres, radii])[chosen]
    return discs[discs[:, 2].argsort()[::-1]].astype(np.float32)


def _depth(points: Array, corners: Array) -> Array:
    """Return [P] m from points [P,2] to the nearest edge, negative outside the outline."""
    along = np.roll(corners, -1, axis=0) - corners
    inward = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1)[:, None]
    return ((points[:, None] - corners) * inward).sum(-1).min(1)


def _inside(corners: Array, spacing: float) -> Array:
    """Return points [P,2] of a grid inside the outline, symmetric about its box's middle."""
    low, high = corners.min(0), corners.max(0)
    counts = 2 * np.ceil(0.5 * (high - low) / spacing).astype(int)
    axes = [np.linspace(low[i], high[i], counts[i] + 1) for i in range(2)]
    grid = np.stack(np.meshgrid(*axes), -1).reshape(-1, 2)
    return grid[_depth(grid, corners) > 0.0]


def _outline(corners: Array, spacing: float) -> Array:
    """Return points [P,2] on the edges, the corners among them."""
    pieces = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = int(np.ceil(np.linalg.norm(end - start) / spacing))
        pieces.append(start + np.arange(count)[:, None] / count * (end - start))
    return np.concatenate(pieces)


def _set_cover(covers: NDArray[np.bool_]) -> list[int]:
    """Return the columns of [P,C] that cover every row, each time the one with the most rows."""
    chosen, open_rows = [], np.ones(len(covers), np.bool_)
    while open_rows.any():
        chosen.append(int(covers[open_rows].sum(0).argmax()))
        open_rows &= ~covers[:, chosen[-1]]
    return chosen
