"""Stage 1: noisy points near an anchor to the trajectory that was meant, and how likely it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.diffusiondrive.config import POSES, DiffusionDriveConfig
from anchorflow_models.diffusiondrive.trajectories import (
    POINT_FEATURES,
    TrajectorySpace,
    embedded_points,
)
from anchorflow_models.layers.attention import Attention, FeedForward
from anchorflow_models.layers.blocks import zero_linear
from anchorflow_models.layers.places import lookup_sum, sinusoidal
from anchorflow_models.transfuser import bev_places


@dataclass(frozen=True, eq=False)
class SceneFeatures:
    """Worked out once a scene; of bev and values a graph of its own has what it reads, for both.

    bev: [B, W, H, H], of the square that the LiDAR sees, or with `ground_sight` of one before it
    values: [B, L, H, H, W], what each layer of the denoiser looks up in it
    agents: [B, Q, W], a query each
    ego: [B, 1, W]
    motion: [B, 4] the ego's velocity (m/s) and acceleration (m/s²), with `ego_motion`
    foretold: [B, FORETOLD_TIMES, H', H] the share of each cell that others take at these times,
        beyond the LiDAR's square too, with `encounters`
    """

    bev: Tensor
    values: Tensor
    agents: Tensor
    ego: Tensor
    motion: Tensor | None = None
    foretold: Tensor | None = None


FIRST_LOOK = 2.0
"""Logit of the point that a head begins by looking at; the others' are 0."""


class BevAttention(nn.Module):
    """Each query takes the values at its trajectory's points, by weights of its own choice.

    heads: shares of the values, each with weights of its own; several begin by looking at one point
        each, from the first to the last
    reach: m from the middle of the BEV to its edges; ahead: m from the ego forward to its middle
    """

    def __init__(
        self, width: int, *, points: int, heads: int, reach: float, ahead: float = 0.0
    ) -> None:
        super().__init__()
        self.reach, self.ahead, self.heads = reach, ahead, heads
        self.weights = nn.Linear(width, heads * points)
        if heads > 1:
            own = torch.arange(heads) * points // heads
            with torch.no_grad():
                self.weights.bias.copy_(FIRST_LOOK * F.one_hot(own, points).flatten())
        self.out = nn.Linear(width, width)

    def forward(self, queries: Tensor, points: Tensor, values: Tensor) -> Tensor:
        """What to add to queries [B, N, W]; points: [B, N, T, 2] m; values: [B, H, H, W]"""
        weights = self.weights(queries).unflatten(-1, (self.heads, -1)).softmax(-1)
        places = bev_places(points, self.reach, ahead=self.ahead)
        return self.out(lookup_sum(values, places, weights))


LONGEST = 10_000.0  # wavelength of a diffusion time, in levels


@dataclass(frozen=True, eq=False)
class Denoised:
    """The prediction of a layer of the denoiser.

    trajectories: [B, N, T, 3] m, rad; logits: [B, N], whether it is the one that is driven
    """

    trajectories: Tensor
    logits: Tensor


class DenoiserLayer(nn.Module):
    """A query a trajectory: it attends to the BEV along its points, to agents and ego, is modulated
    by the time, and predicts how to move its points.
    """

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        width, heads = config.width, config.heads
        self.look = BevAttention(
            width,
            points=POSES,
            heads=config.look_heads,
            reach=config.backbone.lidar_range,
            ahead=config.bev_ahead,
        )
        self.agents, self.ego = Attention(width, heads), Attention(width, heads)
        self.feed_forward = FeedForward(width, config.hidden)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(4))
        self.modulation = nn.Sequential(nn.Mish(), nn.Linear(width, 2 * width))
        self.poses = nn.Sequential(
            nn.Linear(width, width), nn.ReLU(), zero_linear(width, 3 * POSES)
        )
        self.likely = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(
        self, x: Tensor, points: Tensor, time: Tensor, scene: SceneFeatures, values: Tensor
    ) -> tuple[Tensor, Denoised]:
        """x: [B, N, W]; points: [B, N, T, 2] m; time: [B or 1, W]; values: [B, H, H, W]"""
        look, agents, ego, feed = self.norms
        x = look(x + self.look(x, points, values))
        x = agents(x + self.agents(x, scene.agents))
        x = ego(x + self.ego(x, scene.ego))
        x = feed(x + self.feed_forward(x))
        scale, shift = self.modulation(time)[:, None].chunk(2, -1)
        x = x * (1 + scale) + shift
        moved = self.poses(x).unflatten(-1, (POSES, 3))
        heading = math.pi * moved[..., 2:].tanh()
        poses = torch.cat([points + moved[..., :2], heading], -1)
        return x, Denoised(poses, self.likely(x).squeeze(-1))


class Denoiser(nn.Module):
    """Each layer begins where the one before has moved the points."""

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        width = config.width
        self.width = width
        self.space = TrajectorySpace(config)
        self.embed = nn.Sequential(
            nn.Linear(POSES * POINT_FEATURES, width), nn.ReLU(), nn.Linear(width, width)
        )
        self.time = nn.Sequential(
            nn.Linear(width, 4 * width), nn.Mish(), nn.Linear(4 * width, width)
        )
        self.layers = nn.ModuleList(DenoiserLayer(config) for _ in range(config.denoiser_layers))

    def forward(self, x_t: Tensor, t: Tensor, scene: SceneFeatures) -> list[Denoised]:
        """x_t: [B, N, T, 2] in the diffusion's units; t: [B or 1] levels -> one a layer"""
        points = self.space.metric(x_t)
        time = self.time(sinusoidal(t, self.width, longest=LONGEST, shortest=2 * math.pi))
        x = self.embed(embedded_points(points))
        made = []
        for layer, values in zip(self.layers, scene.values.unbind(1), strict=True):
            x, denoised = layer(x, points, time, scene, values)
            points = denoised.trajectories[..., :2].detach()
            made.append(denoised)
        return made
