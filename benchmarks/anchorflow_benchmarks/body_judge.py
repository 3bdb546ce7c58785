"""A judge of poses: points of the outline along small steps, and no code of the planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
STEP = 0.01  # m, or rad times the farthest point, between two poses
SPACING = 0.03  # m between points inside of the outline: less than lets a cell of 0.05 m through
BLOCK, MOMENT = 128, 0.02  # poses at once, and s between two moments


@dataclass(frozen=True)
class BodyJudge:
    """A map of square cells about (0, 0), and an outline [K, 2] in m, counter-clockwise."""

    occupied: NDArray[np.bool_]
    resolution: float
    footprint: Array

    def touches(self, poses: Array) -> bool:
        """Return whether the outline or its inside meets an occupied cell along poses [T, 3]."""
        body, way = self._body(), _dense(poses, float(np.hypot(*self.footprint.T).max()))
        height, width = self.occupied.shape
        for first in range(0, len(way), BLOCK):
            x, y, heading = way[first : first + BLOCK, :, None].transpose(1, 0, 2)
            cosine, sine = np.cos(heading), np.sin(heading)
            east = x + cosine * body[:, 0] - sine * body[:, 1]
            north = y + sine * body[:, 0] + cosine * body[:, 1]
            column = np.floor(east / self.resolution + width / 2).astype(int)
            row = np.floor(north / self.resolution + height / 2).astype(int)
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            if not inside.all() or self.occupied[row, column].any():
                return True
        return False

    def meets(self, poses: Array, duration: float, places: Array, radii: Array) -> bool:
        """Return whether discs with centres [M, 2, 2], now and in 1 s, meet poses [T, 3]."""
        times = np.linspace(0.0, duration, len(poses))
        fine = np.linspace(0.0, duration, int(duration / MOMENT) + 2)
        heading = np.unwrap(poses[:, 2].astype(float))
        x, y, turns = (np.interp(fine, times, z) for z in (*poses[:, :2].T, heading))
        body, reach = self._body(), float(np.hypot(*self.footprint.T).max())
        for place, radius in zip(places, radii, strict=True):
            aside = (place[0] + fine[:, None] * (place[1] - place[0])).T - (x, y)
            near = np.hypot(*aside) < radius + reach
            (east, north), turn = aside[:, near, None], turns[near, None]
            ahead = np.cos(turn) * east + np.sin(turn) * north - body[:, 0]
            left = np.cos(turn) * north - np.sin(turn) * east - body[:, 1]
            if (np.hypot(ahead, left) < radius).any():
                return True
        return False

    def _body(self) -> Array:
        low, high = self.footprint.min(0), self.footprint.max(0)
        x, y = np.meshgrid(*(np.arange(a, b, SPACING) for a, b in zip(low, high, strict=True)))
        points = np.stack([x.ravel(), y.ravel()], 1)
        edges = np.roll(self.footprint, -1, 0) - self.footprint
        for corner, edge in zip(self.footprint, edges, strict=True):
            aside = points - corner
            points = points[edge[0] * aside[:, 1] - edge[1] * aside[:, 0] >= 0.0]
        share = np.arange(0.0, 1.0, 0.01)[:, None, None]
        rim = (self.footprint + share * edges).reshape(-1, 2)
        return np.concatenate([points, rim])


def _dense(poses: Array, reach: float) -> Array:
    heading = np.unwrap(poses[:, 2].astype(float))
    legs = np.hypot(*np.diff(poses[:, :2].astype(float), axis=0).T)
    legs = np.maximum(legs, reach * np.abs(np.diff(heading))) + 1e-9
    marks = np.append(0.0, legs.cumsum())
    at = np.linspace(0.0, marks[-1], int(marks[-1] / STEP) + 2)
    return np.stack([np.interp(at, marks, z) for z in (poses[:, 0], poses[:, 1], heading)], 1)


def sideways(poses: Array, velocities: Array) -> Array:
    """Return the speeds [...] in m/s across the heading."""
    heading = poses[..., 2]
    return -velocities[..., 0] * np.sin(heading) + velocities[..., 1] * np.cos(heading)


def ahead(poses: Array, velocities: Array) -> Array:
    """Return the speeds [...] in m/s along the heading; below 0 backwards."""
    heading = poses[..., 2]
    return velocities[..., 0] * np.cos(heading) + velocities[..., 1] * np.sin(heading)


def driven(poses: Array, velocities: Array, duration: float) -> Array:
    """Drive a bicycle open loop with the speeds and curvatures of an anchor [T, 3]; its end [3]."""
    times = np.linspace(0.0, duration, len(poses))
    speed = ahead(poses, velocities).astype(float)
    moves = np.abs(speed) > 0.02
    bend = np.interp(times, times[moves], velocities[moves, 2] / speed[moves])
    fine = np.linspace(0.0, duration, int(duration / 0.002))
    pace, curve = np.interp(fine, times, speed), np.interp(fine, times, bend)
    x, y, heading = poses[0].astype(float)
    for v, k in zip(pace, curve, strict=True):
        turn = v * k * (fine[1] - fine[0])
        x += v * (fine[1] - fine[0]) * np.cos(heading + turn / 2)
        y += v * (fine[1] - fine[0]) * np.sin(heading + turn / 2)
        heading += turn
    return np.array([x, y, heading])
