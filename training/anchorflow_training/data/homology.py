"""Which trajectories of a scene pass the obstacles on the same sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, minimum_position

FloatArray = NDArray[np.floating]

EIGHT_NEIGHBOURS = np.ones((3, 3))


def obstacle_points(
    clearance: FloatArray, resolution: float, origin: NDArray[np.floating]
) -> NDArray[np.float64]:
    """A point [2] m inside each obstacle that the robot's centre has to go round, [K, 2].

    clearance: [H, W] m. Obstacles that the robot does not fit between are one.
    """
    obstacles, count = label(clearance < 0, EIGHT_NEIGHBOURS)  # type: ignore[misc]
    if not count:
        return np.empty((0, 2))
    deepest = minimum_position(clearance, obstacles, np.arange(1, count + 1))
    return np.asarray(origin) + (np.asarray(deepest, float)[:, ::-1] + 0.5) * resolution


def homology_classes(positions: FloatArray, points: FloatArray) -> NDArray[np.int64]:
    """A class [M] for each of a scene's trajectories [M, T, D >= 2], from 0 up.

    Two trajectories with common ends are in one class where their loop winds round none of the
    `points` [K, 2]: where both sweep the same angle as seen from each.
    """
    if not len(points):
        return np.zeros(len(positions), np.int64)
    rays = positions[:, None, :, :2] - points[:, None]
    angle = np.arctan2(rays[..., 1], rays[..., 0])
    # A straight piece sweeps less than half a turn.
    steps = (np.diff(angle, axis=-1) + np.pi) % (2 * np.pi) - np.pi
    swept = steps.sum(-1)
    turns = np.rint((swept - swept[:1]) / (2 * np.pi)).astype(np.int64)
    return np.unique(turns, axis=0, return_inverse=True)[1].reshape(-1)
