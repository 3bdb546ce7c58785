"""The networks of GoalFlow: the scene, the scores of ways to goals, and the vector field.

Both fields predict the controls of the trajectory that they expect at the end of the flow, as
differences from those of the way that it began on. The kinematic model rolls them out, so that
every answer can be driven, and the slope of the straight path follows: u = (x_1 - x_t) / (1 - t).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.goalflow.config import GoalFlowConfig
from anchorflow_models.layers.attention import AdaLNBlock, neutral_modulation
from anchorflow_models.layers.blocks import ResidualBlock, zero_linear
from anchorflow_models.layers.places import GaussianFourierTime, lookup, sinusoidal_positions
from anchorflow_models.transfuser import STATUS

Extent = tuple[float, float, float, float]
VELOCITY = 4  # in the ego status, the first of two
X_UNIT, Y_UNIT = 40.0, 20.0
"""m, scales of places for the networks."""
TAKEN = -1e9
CONTROLS = 2  # acceleration, curvature


def at_places(cells: Tensor, places: Tensor, extent: Extent) -> Tensor:
    """Look up a raster at places: [B, H, W, F], [B, ..., 2] m -> [B, ..., F].

    extent: least and greatest x, least and greatest y; row 0 is at the greatest x, column 0 at
        the greatest y. Beyond its edge the raster repeats its last cells.
    """
    low_x, high_x, low_y, high_y = extent
    across = 1 - 2 * (places[..., 1] - low_y) / (high_y - low_y)
    down = 1 - 2 * (places[..., 0] - low_x) / (high_x - low_x)
    points = torch.stack([across, down], -1)
    found = lookup(cells, points.flatten(1, -2))
    return found.unflatten(1, places.shape[1:-1])


def at_times(layers: Tensor, places: Tensor, layer: Tensor, extent: Extent) -> Tensor:
    """Look up a stack of rasters at places, each in a layer of its own.

    layers: [B, K, H, W]; places: [B, ..., P, 2] m; layer: [P] from 0 to K - 1; returns [B, ..., P]
    """
    batch, count, height, width = layers.shape
    low_x, high_x, low_y, high_y = extent
    across = 1 - 2 * (places[..., 1] - low_y) / (high_y - low_y)
    row = (high_x - places[..., 0]) / (high_x - low_x) * height - 0.5
    # Laid below one another; a row that stays inside its layer mixes with no other.
    row = row.clamp(0, height - 1) + height * layer.to(row.dtype)
    down = (2 * row + 1) / (count * height) - 1
    points = torch.stack([across, down], -1).flatten(1, -2)
    found = lookup(layers.reshape(batch, count * height, width, 1), points)
    return found.reshape(across.shape)


class SceneEncoder(nn.Module):
    """A small feature pyramid over the raster: strides 4, 8 and 16, and back up to 4.

    stride: cells of the inputs a side of a cell of the first level
    """

    def __init__(
        self, *, inputs: int, stride: int, channels: int, features: int, context: int
    ) -> None:
        super().__init__()
        fine, middle, coarse = channels, 2 * channels, 3 * channels
        self.stem = nn.Conv2d(inputs, fine, stride, stride=stride)
        self.middle = nn.Conv2d(fine, middle, 3, stride=2, padding=1)
        self.coarse = nn.Conv2d(middle, coarse, 3, stride=2, padding=1)
        self.blocks = nn.ModuleList(ResidualBlock(width) for width in (middle, coarse))
        self.to_middle = nn.Conv2d(coarse, middle, 1)
        self.to_fine = nn.Conv2d(middle, fine, 1)
        self.mix = nn.Conv2d(fine, fine, 3, padding=1)
        self.out = nn.Conv2d(fine, features, 1)
        self.context = nn.Sequential(
            nn.Linear(2 * coarse + STATUS + 2, context), nn.SiLU(), nn.Linear(context, context)
        )

    def forward(self, bev: Tensor, status: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
        """bev [B, C, H, W] from 0 to 1, or features; status [B, 8]; size [B, 2] of the ego, m.

        Returns features [B, H/stride, W/stride, F] and context [B, E].
        """
        fine = F.silu(self.stem(bev))
        middle = self.blocks[0](self.middle(fine))
        coarse = self.blocks[1](self.coarse(F.silu(middle)))
        up = middle + F.interpolate(self.to_middle(coarse), scale_factor=2.0)
        up = fine + F.interpolate(self.to_fine(F.silu(up)), scale_factor=2.0)
        features = self.out(F.silu(self.mix(F.silu(up)))).permute(0, 2, 3, 1)
        summary = [coarse.mean((2, 3)), coarse.amax((2, 3))]
        return features, self.context(torch.cat([*summary, _in_units(status), size / 5.0], -1))


def _in_units(status: Tensor) -> Tensor:
    """Velocities in tens of m/s, accelerations in threes of m/s²."""
    command, velocity, acceleration = status.split([VELOCITY, 2, 2], -1)
    return torch.cat([command, velocity / 10.0, acceleration / 3.0], -1)


class WayScores(NamedTuple):
    """Logits [B, P] of ways: that they end near where was driven, stay on the road, follow the
    route."""

    distance: Tensor
    drivable: Tensor
    route: Tensor


def in_units(poses: Tensor) -> Tensor:
    """Scale poses [..., 3] for the networks: [..., 4]."""
    x, y, heading = poses.unbind(-1)
    return torch.stack([x / X_UNIT, y / Y_UNIT, heading.cos(), heading.sin()], -1)


class WayScorer(nn.Module):
    """Scores delta = delta_dac · delta_dis of ways to goals, by the features at their poses."""

    def __init__(self, *, steps: int, features: int, context: int, width: int) -> None:
        super().__init__()
        self.of_way = nn.Linear(steps * (features + 4), width)
        self.of_scene = nn.Linear(context, width)
        self.rest = nn.Sequential(nn.SiLU(), nn.Linear(width, width), nn.SiLU())
        self.out = nn.Linear(width, 3)

    def forward(
        self, poses: Tensor, features: Tensor, context: Tensor, *, extent: Extent
    ) -> WayScores:
        """poses [B, P, T, 3]; features [B, h, w, F]; context [B, E]."""
        seen = at_places(features, poses[..., :2], extent)
        way = torch.cat([seen, in_units(poses)], -1).flatten(2)
        hidden = self.rest(self.of_way(way) + self.of_scene(context)[:, None])
        return WayScores(*self.out(hidden).unbind(-1))


def pick(goals: Tensor, scores: Tensor, *, count: int, spacing: float) -> Tensor:
    """Return indices [B, count] of the best goals that keep their spacing, the best first.

    goals: [K, 2] m; scores: [B, K] from 0 to 1. If too few are left, those near
    to the fewest picked goals follow.
    """
    number = torch.arange(goals.shape[0], device=goals.device)
    left, picked = scores, []
    for _ in range(count):
        best = left.argmax(-1)
        picked.append(best)
        near = (goals[best][:, None] - goals).square().sum(-1) < spacing**2
        # Below all that are near to fewer.
        left = torch.where(near, left - 2.0, left)
        left = torch.where(number == best[:, None], TAKEN, left)
    return torch.stack(picked, -1)


class MlpField(nn.Module):
    """A residual MLP over the whole trajectory."""

    def __init__(self, config: GoalFlowConfig, *, token: int) -> None:
        super().__init__()
        width, self.steps = config.width, config.num_steps
        self.time = GaussianFourierTime(width)
        self.of_scene = nn.Linear(config.context, width)
        self.first = nn.Linear(config.num_steps * token, width)
        self.hidden = nn.ModuleList(
            nn.Sequential(nn.SiLU(), nn.Linear(width, width)) for _ in range(config.layers)
        )
        self.out = zero_linear(width, CONTROLS * config.num_steps)

    def modulate(self, times: Tensor, context: Tensor) -> Tensor:
        """Times [B or 1, K] and context [B, E] -> [B, K, M]."""
        return self.time(times) + self.of_scene(context)[:, None]

    def forward(self, tokens: Tensor, modulation: Tensor) -> Tensor:
        """tokens [B, N, T, F], modulation [B, 1 or N, M] -> [B, N, T, 2]."""
        x = self.first(tokens.flatten(2)) + modulation
        for layer in self.hidden:
            x = x + layer(x)
        return self.out(x).unflatten(-1, (self.steps, CONTROLS))


class TransformerField(nn.Module):
    """AdaLN blocks over the trajectory's poses."""

    positions: Tensor

    def __init__(self, config: GoalFlowConfig, *, token: int) -> None:
        super().__init__()
        width = config.width
        self.time = GaussianFourierTime(width)
        self.of_scene = nn.Linear(config.context, width)
        neutral = neutral_modulation(width, blocks=config.layers)
        to_modulation = zero_linear(width, len(neutral))
        to_modulation.bias.data.copy_(neutral)
        self.to_modulation = nn.Sequential(nn.SiLU(), to_modulation)
        self.first = nn.Linear(token, width)
        self.register_buffer("positions", sinusoidal_positions(config.num_steps, width))
        self.blocks = nn.ModuleList(AdaLNBlock(width, config.heads) for _ in range(config.layers))
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.out = zero_linear(width, CONTROLS)

    def modulate(self, times: Tensor, context: Tensor) -> Tensor:
        """Times [B or 1, K] and context [B, E] -> [B, K, M]."""
        return self.to_modulation(self.time(times) + self.of_scene(context)[:, None])

    def forward(self, tokens: Tensor, modulation: Tensor) -> Tensor:
        """tokens [B, N, T, F], modulation [B, 1 or N, M] -> [B, N, T, 2]."""
        x, width = self.first(tokens) + self.positions, self.positions.shape[-1]
        parts = modulation[..., None, :].split(
            [6 * width] * len(self.blocks) + [width, width], dim=-1
        )
        for block, part in zip(self.blocks, parts[:-2], strict=True):
            x = block(x, part)
        return self.out(self.norm(x) * parts[-1] + parts[-2])


FIELDS = {"mlp": MlpField, "transformer": TransformerField}
