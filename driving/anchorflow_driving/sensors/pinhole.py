"""The pinhole camera of simulated and of painted pictures, and the three that planners expect."""

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

    @property
    def rays(self) -> Array:
        """[rows, columns, 3]: the directions of the pixels' middles in the camera's frame."""
        down, across = np.mgrid[: self.rows, : self.columns] + 0.5
        ahead = np.full((self.rows, self.columns), self.focal)
        seen = np.stack([across - self.columns / 2, down - self.rows / 2, ahead], -1)
        return seen @ self.axes

    def matrix(self, near: float, far: float) -> Array:
        """Return [4, 4] from the frame to OpenGL's clip space, between two depths in m."""
        look = np.eye(4)
        look[:3, :3] = self.axes * np.array([1.0, -1.0, -1.0])[:, None]
        look[:3, 3] = -look[:3, :3] @ np.array(self.place)
        lens = np.diag([2 * self.focal / self.columns, 2 * self.focal / self.rows, 0.0, 0.0])
        lens[2, 2:] = (far + near) / (near - far), 2 * far * near / (near - far)
        lens[3, 2] = -1.0
        return lens @ look


# A quarter of the 1920 x 1080 pixels of nuPlan's cameras, whose focal length is 1545 pixels: so
# the stitched picture needs no resizing.
ROWS, COLUMNS, FOCAL = 270, 480, 1545.0 / 4
AHEAD, HEIGHT, SIDE_YAW = 1.7, 1.5, float(np.deg2rad(55.0))
"""m before the rear axle and above the ground; the side cameras are turned outwards."""


def reference_camera(yaw: float, *, scale: int = 1) -> PinholeCamera:
    """Return one of the cameras that NAVSIM's planners look through, in a size times `scale`."""
    place, size = (AHEAD, 0.0, HEIGHT), (scale * ROWS, scale * COLUMNS)
    return PinholeCamera(place, yaw, 0.0, scale * FOCAL, *size)


YAWS = (SIDE_YAW, 0.0, -SIDE_YAW)
REFERENCE_CAMERAS = tuple(map(reference_camera, YAWS))
"""Left, front and right."""
