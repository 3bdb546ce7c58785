"""The pinhole camera of simulated and of painted pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_driving.geometry import Array


@dataclass(frozen=True)
class PinholeCamera:
    """A camera's position and direction in its frame, and its picture.

    place: x, y, z above the ground, m
    yaw, pitch: rad; to the left, and up
    focal: in pixels
    """

    place: tuple[float, float, float]
    yaw: float
    pitch: float
    focal: float
    rows: int
    columns: int

    @property
    def axes(self) -> Array:
        """[3, 3]: the camera's directions to the right, below and ahead."""
        cy, sy, cp, sp = np.cos(self.yaw), np.sin(self.yaw), np.cos(self.pitch), np.sin(self.pitch)
        ahead, right = np.array([cp * cy, cp * sy, sp]), np.array([sy, -cy, 0.0])
        return np.stack([right, np.cross(ahead, right), ahead])

    def seen(self, points: Array) -> Array:
        """Return points [n, 3] of the frame along the camera's axes."""
        return (points - np.array(self.place)) @ self.axes.T

    def project(self, seen: Array) -> Array:
        """Return the pixels [n, 2], from the left and from above, of points before the camera."""
        across, down = self.focal * seen[:, :2].T / seen[:, 2]
        return np.stack([self.columns / 2 + across, self.rows / 2 + down], -1)

    def matrix(self, near: float, far: float) -> Array:
        """Return [4, 4] from the frame to OpenGL's clip space, between two depths in m."""
        look = np.eye(4)
        look[:3, :3] = self.axes * np.array([1.0, -1.0, -1.0])[:, None]
        look[:3, 3] = -look[:3, :3] @ np.array(self.place)
        lens = np.diag([2 * self.focal / self.columns, 2 * self.focal / self.rows, 0.0, 0.0])
        lens[2, 2:] = (far + near) / (near - far), 2 * far * near / (near - far)
        lens[3, 2] = -1.0
        return lens @ look
