"""A simulated world for a robot with ROS 2: its base, its lidar, and the maps made of the scans.

Worlds, lidar and the mapping are those of the closed-loop benchmarks; the maps are published as
Nav2 publishes its cost maps, with inflation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from anchorflow_benchmarks.closed_loop.lidar_mapping import Lidar, LocalMap, Scan
from anchorflow_benchmarks.closed_loop.worlds import World, posts_of_cells
from anchorflow_client.contract.ros_grid import (
    INFLATED,
    INSCRIBED_PERCENT,
    LETHAL_PERCENT,
    OCCUPIED_PERCENT,
)
from anchorflow_client.ros_map import load_ros_map
from anchorflow_ros.frames import Pose

Array = NDArray[np.float64]

FIELD_OF_VIEW = 1.5 * math.pi
MARGIN = 1.0
"""m of free space round the posts of a world on its full grid."""


@dataclass
class Base:
    """A differential drive that reaches a commanded twist as fast as its motors can."""

    pose: Pose
    a_max: float = 3.0
    alpha_max: float = 6.0
    v: float = 0.0
    """m/s"""
    w: float = 0.0
    """rad/s"""

    def step(self, v: float, w: float, dt: float) -> None:
        """Move for a time in s towards the commanded speed and turn rate."""
        before = self.v, self.w
        self.v += float(np.clip(v - self.v, -self.a_max * dt, self.a_max * dt))
        self.w += float(np.clip(w - self.w, -self.alpha_max * dt, self.alpha_max * dt))
        way, turn = 0.5 * dt * (before[0] + self.v), 0.5 * dt * (before[1] + self.w)
        course = self.pose.yaw + 0.5 * turn
        self.pose = Pose(
            self.pose.x + way * math.cos(course),
            self.pose.y + way * math.sin(course),
            math.remainder(self.pose.yaw + turn, math.tau),
        )


@dataclass
class Eyes:
    """A lidar, and the rolling map that is made of its scans alone."""

    world: World
    lidar: Lidar = field(default_factory=lambda: Lidar(FIELD_OF_VIEW))
    local: LocalMap = field(default_factory=lambda: LocalMap(cells=240, resolution=0.04))
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def scan(self, pose: Pose) -> Scan:
        """Scan from a pose, and add the scan to the map."""
        here = np.array([pose.x, pose.y, pose.yaw])
        reach = self.lidar.max_range + self.world.post_radius
        near = np.linalg.norm(self.world.posts - here[:2], axis=1) < reach
        scan = self.lidar.scan(replace(self.world, posts=self.world.posts[near]), here, self.rng)
        self.local.add(scan)
        return scan


@dataclass(frozen=True)
class Inflation:
    """Nav2's inflation layer: radius and inscribed radius in m, and the decay in 1/m."""

    radius: float = 0.55
    inscribed: float = 0.25
    decay: float = 3.0

    def percent(self, occupied: NDArray[np.bool_], resolution: float) -> NDArray[np.int8]:
        """Return the grid [H,W] as Nav2 publishes it: 100 occupied, 99 inscribed, 0 to 98."""
        if not occupied.any():
            return np.zeros(occupied.shape, np.int8)
        away = resolution * np.asarray(distance_transform_edt(~occupied))
        cost = np.floor(INFLATED * np.exp(-self.decay * np.maximum(away - self.inscribed, 0.0)))
        soft = np.where(cost > 0, 1 + 97 * (cost - 1) / (INFLATED - 1), 0)
        return np.select(
            [occupied, away <= self.inscribed, away <= self.radius],
            [LETHAL_PERCENT, INSCRIBED_PERCENT, soft.astype(int)],
            0,
        ).astype(np.int8)


def whole_grid(world: World, resolution: float) -> tuple[NDArray[np.bool_], Array]:
    """Return the occupied cells [H,W] of a whole world, and the corner [2] m of cell (0, 0)."""
    points = np.concatenate([world.posts, world.start[None, :2], world.goal[None]])
    origin = points.min(0) - MARGIN
    width, height = np.ceil((points.max(0) + MARGIN - origin) / resolution).astype(int)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = origin + resolution * np.stack([x, y], -1).reshape(-1, 2)
    reach = world.post_radius + 0.5 * resolution
    nearest, _ = KDTree(world.posts).query(centres, distance_upper_bound=2 * reach)
    return nearest.reshape(height, width) < reach, origin


def world_of_map(path: Path, start: Pose, goal: tuple[float, float]) -> World:
    """Return the world of a map server's YAML file: every occupied cell is a post.

    Raises `RosMapError`.
    """
    ros_map = load_ros_map(path, unknown_is_free=True)
    occupied = ros_map.values[:, :] >= OCCUPIED_PERCENT
    return World(
        name=path.stem,
        posts=posts_of_cells(occupied, ros_map.resolution, ros_map.origin),
        post_radius=0.5 * ros_map.resolution,
        start=np.array([start.x, start.y, start.yaw]),
        goal=np.array(goal),
        path_length=math.nan,
    )
