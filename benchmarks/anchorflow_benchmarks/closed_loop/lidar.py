"""A planar lidar: distances to the nearest post along a fan of beams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.closed_loop.world import World

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Scan:
    """pose: [3] x, y in m, yaw in rad, of the robot; bearings: [L] rad in the robot's frame.

    ranges: [L] m; hits: [L], False where a beam met nothing within the lidar's range
    """

    pose: Array
    bearings: Array
    ranges: Array
    hits: NDArray[np.bool_]


@dataclass(frozen=True)
class Lidar:
    """beams over field_of_view rad, up to max_range m; noise: m, standard deviation of a range."""

    field_of_view: float
    beams: int = 360
    max_range: float = 10.0
    noise: float = 0.01

    def scan(self, world: World, pose: Array, rng: np.random.Generator) -> Scan:
        """What the robot sees from a pose [3]."""
        bearings = self.field_of_view * ((np.arange(self.beams) + 0.5) / self.beams - 0.5)
        angles = bearings + pose[2]
        distances = ray_distances(
            (world.posts - pose[:2]).astype(np.float32), world.post_radius, angles
        )
        hits = distances < self.max_range
        noisy = np.maximum(distances + rng.normal(0.0, self.noise, self.beams), 0.0)
        return Scan(np.array(pose), bearings, np.where(hits, noisy, self.max_range), hits)


def ray_distances(centres: Array, radius: float, angles: Array) -> Array:
    """m from the origin to the nearest circle along each angle: [L]; infinite where there is none.

    centres: [M, 2] m
    """
    directions = np.stack([np.cos(angles), np.sin(angles)], 1).astype(centres.dtype)
    # |s u - c|^2 = r^2 has the roots s = u.c ± sqrt((u.c)^2 - (c.c - r^2)).
    along = directions @ centres.T
    discriminant = along**2 - ((centres**2).sum(1) - centres.dtype.type(radius) ** 2)
    entry = along - np.sqrt(np.maximum(discriminant, 0.0))
    met = (discriminant >= 0.0) & (along > 0.0)
    return np.maximum(np.where(met, entry, np.inf).min(1, initial=np.inf), 0.0)
