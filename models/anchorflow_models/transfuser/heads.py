"""Heads of a Transfuser backbone beside the plan: other agents, semantics, occupancy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.transfuser.config import SEMANTIC_STRIDE, TransfuserConfig
from anchorflow_models.transfuser.lidar_flow import Moving

AGENT_QUERIES = 30
AGENT_STATE = 5
"""x, y, heading, length, width"""


@dataclass(frozen=True, eq=False)
class Perceived:
    """Predictions of a planner that sees by camera and LiDAR, beside its plan.

    agents: [B, Q, 5] x, y [m], heading [rad], length, width [m]; agent_logits: [B, Q]
    semantics: [B, classes, H/2, H] logits of the half before the ego
    occupancy: [B, T, H/4, H/4] logits of where others will be when the poses are reached
    upscaled: [B, C', H/4, H/4] the backbone's BEV
    moving: others near by and their velocities, with `encounters`; far: those beyond the LiDAR
    """

    agents: Tensor
    agent_logits: Tensor
    semantics: Tensor
    occupancy: Tensor
    upscaled: Tensor
    moving: Moving | None
    far: Moving | None


class SemanticHead(nn.Module):
    """The upscaled BEV to classes of the half before the ego.

    The published head stretches the whole square over that half, and leaves the rest to learning.
    This one cuts the half out first: row 0 lies farthest ahead.
    """

    def __init__(self, config: TransfuserConfig, classes: int) -> None:
        super().__init__()
        self.size = config.semantic_size
        channels = config.bev_channels
        self.hidden = nn.Conv2d(channels, channels, 3, padding=1)
        self.out = nn.Conv2d(channels, classes, 1)

    def forward(self, upscaled: Tensor) -> Tensor:
        """[B, C', H/4, H/4] -> logits [B, classes, H/2, H]; column 0 lies farthest left"""
        ahead = upscaled[:, :, : upscaled.shape[2] // 2]
        logits = self.out(F.relu(self.hidden(ahead)))
        return F.interpolate(logits, size=self.size, mode="bilinear", align_corners=False)


class GroundSemanticHead(nn.Module):
    """The semantic head of a BEV at `ground_ahead`: each cell predicts the classes of all semantic
    cells within it, since a line is narrower than a cell.
    """

    def __init__(self, config: TransfuserConfig, width: int, classes: int) -> None:
        super().__init__()
        self.first, self.rows = config.ground_rows, config.upscaled_size // 2
        self.hidden = nn.Conv2d(width, config.bev_channels, 3, padding=1)
        self.out = nn.Conv2d(config.bev_channels, classes * SEMANTIC_STRIDE**2, 1)

    def forward(self, bev: Tensor) -> Tensor:
        """[B, W, H/4, H/4] -> logits [B, classes, H/2, H]; column 0 lies farthest left"""
        ahead = bev[:, :, self.first : self.first + self.rows]
        return F.pixel_shuffle(self.out(F.relu(self.hidden(ahead))), SEMANTIC_STRIDE)


class OccupancyHead(nn.Module):
    """The upscaled BEV to where others will be, a map a time; it teaches, and is not served."""

    def __init__(self, channels: int, times: int) -> None:
        super().__init__()
        self.hidden = nn.Conv2d(channels, channels, 3, padding=1)
        self.out = nn.Conv2d(channels, times, 1)

    def forward(self, upscaled: Tensor) -> Tensor:
        """[B, C', H/4, H/4] -> logits [B, T, H/4, H/4]"""
        return self.out(F.relu(self.hidden(upscaled)))


class AgentHead(nn.Module):
    """Decoded queries to boxes in the ego's frame, and how sure it is of each.

    reach: m, the greatest x or y
    """

    def __init__(self, width: int, hidden: int, *, reach: float) -> None:
        super().__init__()
        self.reach = reach
        self.state = nn.Sequential(
            nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, AGENT_STATE)
        )
        self.label = nn.Linear(width, 1)

    def forward(self, queries: Tensor) -> tuple[Tensor, Tensor]:
        """[B, Q, W] -> x, y [m], heading [rad], length, width [m] as [B, Q, 5]; logits [B, Q]"""
        raw = self.state(queries)
        place = self.reach * raw[..., :2].tanh()
        heading = math.pi * raw[..., 2:3].tanh()
        return torch.cat([place, heading, raw[..., 3:]], -1), self.label(queries).squeeze(-1)
