"""Trajectories inside the network: units of the diffusion, embeddings, smooth variants."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from anchorflow_models.diffusiondrive.config import FIRST_S, POSES, STEP_S, DiffusionDriveConfig
from anchorflow_models.layers.geometry import in_float32
from anchorflow_models.layers.places import sinusoidal
from anchorflow_models.transfuser import MOTION, STATUS_UNITS

POINT_FEATURES, HEADING_FEATURES = 64, 32
LONGEST, SHORTEST = 256.0, 1.0  # m, wavelengths of the embedding of a point
MOTION_UNITS = (10.0, 3.0, 6.0, 0.5, 3.0)
"""m/s, m/s², m/s³, rad/s, m/s²: what each of a candidate's rates is usually as large as."""
MOTION_FEATURES = 4 + len(MOTION_UNITS) * POSES
MOST = 3.0  # units of a rate; what is beyond is as hard as any
SLOWEST = 0.5  # m/s; below it a curve's direction is no heading


class TrajectorySpace(nn.Module):
    """Points in m to the diffusion's units, in which x_range and y_range are -1 to 1, and back."""

    middle: Tensor
    scale: Tensor

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        ranges = torch.tensor([config.x_range, config.y_range])
        self.register_buffer("middle", ranges.mean(1), persistent=False)
        self.register_buffer("scale", (ranges[:, 1] - ranges[:, 0]) / 2, persistent=False)

    def normalised(self, points: Tensor) -> Tensor:
        """[..., 2] m -> units"""
        return (points - self.middle) / self.scale

    def metric(self, points: Tensor) -> Tensor:
        """[..., 2] units, clipped to -1 to 1, -> m"""
        return points.clamp(-1, 1) * self.scale + self.middle


def embedded_points(points: Tensor) -> Tensor:
    """[..., T, 2] m -> [..., 64 T]"""
    features = POINT_FEATURES // 2
    return sinusoidal(points, features, longest=LONGEST, shortest=SHORTEST).flatten(-3)


def embedded_poses(poses: Tensor) -> Tensor:
    """[..., T, 3] m, rad -> [..., 96 T]"""
    turn = sinusoidal(poses[..., 2], HEADING_FEATURES, longest=2 * math.pi, shortest=math.pi / 8)
    return torch.cat([embedded_points(poses[..., :2]), turn.flatten(-2)], -1)


def motion_features(poses: Tensor, motion: Tensor) -> Tensor:
    """How trajectories go on from the ego's motion, which is what comfort and progress hang on.

    poses: [B, N, T, 3] m, rad; motion: [B, 4] the ego's velocity and acceleration
    -> [B, N, 4 + 5 T]: that motion, and of each step speed, acceleration, jerk, yaw rate and
        lateral acceleration, all in their units and within MOST of them; the first acceleration is
        from the ego's speed, the first jerk from its acceleration
    """
    start = torch.zeros_like(poses[:, :, :1])
    steps = poses - torch.cat([start, poses[:, :, :-1]], 2)
    turn = torch.atan2(steps[..., 2].sin(), steps[..., 2].cos()) / STEP_S
    # The small number keeps the root's gradient finite where nothing moves.
    speed = (steps[..., :2].square().sum(-1) + 1e-6).sqrt() / STEP_S
    acceleration = _differences(speed, motion[:, :1])
    jerk = _differences(acceleration, motion[:, 2:3])
    rates = torch.stack([speed, acceleration, jerk, turn, speed * turn], -1)
    rates = (rates / rates.new_tensor(MOTION_UNITS)).clamp(-MOST, MOST).flatten(-2)
    own = (motion / motion.new_tensor(STATUS_UNITS[MOTION])).clamp(-MOST, MOST)
    return torch.cat([own[:, None].expand(-1, poses.shape[1], -1), rates], -1)


def _differences(rates: Tensor, first: Tensor) -> Tensor:
    """Changes a second of rates [B, N, T] in the middles of steps, from first [B, 1] now."""
    now = first[:, None].expand(-1, rates.shape[1], -1)
    change = rates - torch.cat([now, rates[..., :-1]], -1)
    elapsed = [STEP_S / 2] + [STEP_S] * (POSES - 1)
    return change / change.new_tensor(elapsed)


class Variants(nn.Module):
    """Longer and shorter, wider and narrower copies of trajectories, each a smooth Bezier curve.

    Factors scale with the trajectory, as additive noise would not: a short one stays short, a
    straight one straight.
    """

    spread: Tensor
    positions: Tensor
    slopes: Tensor

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        positions, slopes = bezier_fit(config.bezier_degree)
        self.register_buffer("spread", torch.tensor(config.diversity), persistent=False)
        for name, matrix in (("positions", positions), ("slopes", slopes)):
            self.register_buffer(name, torch.from_numpy(matrix).float(), persistent=False)

    @in_float32
    def forward(self, poses: Tensor, noise: Tensor) -> Tensor:
        """poses: [B, N, T, 3]; noise: [B, N, V, 2], 0 for the trajectory itself -> [B, N V, T, 3]

        The heading is the curve's direction, and the one that was given where it hardly moves.
        """
        factors = (1 + noise * self.spread).flatten(1, 2)[:, :, None]
        copies = poses[:, :, None].expand(-1, -1, noise.shape[2], -1, -1).flatten(1, 2)
        points = copies[..., :2] * factors
        smooth, velocity = self.positions @ points, self.slopes @ points
        moves = velocity.square().sum(-1) > SLOWEST**2
        x = torch.where(moves, velocity[..., 0], 1.0)
        direction = torch.atan2(torch.where(moves, velocity[..., 1], 0.0), x)
        heading = torch.where(moves, direction, copies[..., 2])
        return torch.cat([smooth, heading[..., None]], -1)


def bezier_fit(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices [T, T] from points at 0.5 … 4.0 s to those of the Bezier curve that fits them best,
    and to its velocity there. The curve begins at the origin and is uniform in time.
    """
    times = FIRST_S + STEP_S * np.arange(POSES)
    share = times / times[-1]
    basis = _bernstein(degree, share)[:, 1:]  # the first control point is the origin
    slope = degree * (
        np.pad(_bernstein(degree - 1, share), ((0, 0), (1, 0)))
        - np.pad(_bernstein(degree - 1, share), ((0, 0), (0, 1)))
    )
    control = np.linalg.pinv(basis)
    return basis @ control, slope[:, 1:] @ control / times[-1]


def _bernstein(degree: int, share: np.ndarray) -> np.ndarray:
    """[T, degree + 1]"""
    k = np.arange(degree + 1)
    ways = np.array([math.comb(degree, i) for i in k])
    return ways * share[:, None] ** k * (1 - share[:, None]) ** (degree - k)
