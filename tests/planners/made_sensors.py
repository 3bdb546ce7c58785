"""Pictures and sweeps of a made world: a sky whose colour is its direction, and a post."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL.Image import Image, fromarray

SIZE = (90, 160)
"""Rows and columns of a picture."""
POST = (40.0, 3.0)
"""Where along and left of the street a post stands, 1 m high."""
POST_POINTS = 6


def colour(directions: np.ndarray) -> np.ndarray:
    """Smooth colours [..., 3] of directions [..., 3] in the vehicle's frame."""
    x, y, z = np.moveaxis(directions / np.linalg.norm(directions, axis=-1, keepdims=True), -1, 0)
    azimuth = np.arctan2(y, x)
    return np.stack([127 + 70 * azimuth, 127 + 200 * z, 127 + 100 * np.sin(3 * azimuth)], -1)


def turned(yaw: float, pitch: float = 0.0) -> np.ndarray:
    """[3, 3] from a camera's axes (x right, y down, z ahead) to those of the vehicle."""
    ahead = [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)]
    right = [np.sin(yaw), -np.cos(yaw), 0.0]
    return np.stack([right, np.cross(ahead, right), ahead], 1)


def picture(matrix: np.ndarray, turn: np.ndarray, lens: tuple[float, ...] = (0.0,) * 5) -> Image:
    """What a camera sees of the sky; its lens is undone step by step."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    seen = np.stack([columns, rows, np.ones(SIZE)], -1) @ np.linalg.inv(matrix).T
    u, v = seen[..., 0], seen[..., 1]
    k1, k2, p1, p2, k3 = lens
    x, y = u, v
    for _ in range(30):
        r = x * x + y * y
        radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
        x, y = (
            (u - 2 * p1 * x * y - p2 * (r + 2 * x * x)) / radial,
            (v - p1 * (r + 2 * y * y) - 2 * p2 * x * y) / radial,
        )
    pixels = colour(np.stack([x, y, np.ones(SIZE)], -1) @ turn.T)
    return fromarray(np.rint(pixels).clip(0, 255).astype(np.uint8))


def sweep(x: float, mount: np.ndarray) -> np.ndarray:
    """Points [P, 3] in a LiDAR's frame, of a vehicle that is `x` m along the street.

    The post, the street, and the vehicle's own bonnet.
    """
    heights = np.linspace(0.4, 1.0, POST_POINTS)
    post = [[POST[0] - x, POST[1], height] for height in heights]
    street = [[ahead, left, 0.02] for ahead in (5.0, 12.0) for left in (-1.0, 1.0)]
    bonnet = [[2.0, left, 0.9] for left in (-0.5, 0.0, 0.5) for _ in range(POST_POINTS)]
    points = np.array([*post, *street, *bonnet])
    return (points - mount[:, 3]) @ mount[:, :3]


def write_picture(path: Path, made: Image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    made.save(path, quality=95)


def write_pcd_bin(path: Path, points: np.ndarray) -> None:
    """Write x, y, z, intensity, ring."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(np.pad(points, [(0, 0), (0, 2)]).astype("<f4").tobytes())


def write_pcd(path: Path, points: np.ndarray) -> None:
    """Write as nuPlan's clouds are: binary, other fields beside x, y, z, zeros at the end."""
    names = ("x", "y", "z", "intensity", "ring", "lidar_info")
    kinds = ("<f4", "<f4", "<f4", "u1", "u1", "u1")
    rows = np.zeros(len(points) + 1, list(zip(names, kinds, strict=True)))
    for name, axis in zip("xyz", points.T, strict=True):
        rows[name] = [*axis, np.nan]  # a beam that did not come back
    header = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {' '.join(names)}\nSIZE 4 4 4 1 1 1\n"
        f"TYPE F F F U U U\nCOUNT 1 1 1 1 1 1\nWIDTH {len(rows)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA binary\n"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(header.encode() + rows.tobytes() + bytes(16))
