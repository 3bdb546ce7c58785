"""Who is farther ahead than the LiDAR sees, by the front camera."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.lookup import lookup
from anchorflow_models.layers.pixels import PIXEL_MEAN, PIXEL_SPREAD
from anchorflow_models.transfuser.camera_places import FRONT_CAMERA, span, within
from anchorflow_models.transfuser.config import TransfuserConfig
from anchorflow_models.transfuser.sweep_motion import UNITS, Moving

BAND = (0.375, 0.625)
"""Of the picture's rows: where what is far stands, about the horizon."""
FRONT = (0.25, 0.75)
"""Of its columns: the front camera's, and a little beside it."""
LOOKED_AT = (0.0, 0.8, 1.6)
"""m above the ground of a place, where the picture is looked up for it."""
EYES, WIDTH, DILATIONS = 32, 48, (1, 2, 4, 1)
DEPTH = 2  # cells one behind the other that are told by one place
NOBODY = -20.0
"""The logit of where it does not look."""


class FarSight(nn.Module):
    """The front camera's picture, looked up where places on the ground beyond the LiDAR's square
    appear in it (as Simple-BEV does, arXiv 2206.07959): whether somebody stands there, and what
    velocity he likely has, by one picture.
    """

    places: Tensor
    ground: Tensor
    pixel_mean: Tensor
    pixel_spread: Tensor

    def __init__(self, config: TransfuserConfig) -> None:
        super().__init__()
        self.rows, self.columns = span(BAND, config.image_height), span(FRONT, config.image_width)
        self.depth, self.breadth = config.far_size
        self.eyes = nn.Sequential(
            nn.Conv2d(3, EYES // 2, 5, padding=2),
            nn.ReLU(),
            nn.Conv2d(EYES // 2, EYES, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(EYES, EYES, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(EYES, EYES, 3, padding=1),
            nn.ReLU(),
        )
        self.lift = nn.Conv2d(len(LOOKED_AT) * EYES + 2, WIDTH, 1)
        self.around = nn.ModuleList(
            nn.Conv2d(WIDTH, WIDTH, 3, padding=each, dilation=each) for each in DILATIONS
        )
        self.tell = nn.Conv2d(WIDTH, 3 * DEPTH, 1)
        ground = _ground(config)
        for name, values in (
            ("places", self._places(ground, config)),
            ("ground", torch.stack([ground[..., 0] / 100, ground[..., 1] / 30])),
            ("pixel_mean", 255 * torch.tensor(PIXEL_MEAN)[:, None, None]),
            ("pixel_spread", 255 * torch.tensor(PIXEL_SPREAD)[:, None, None]),
        ):
            self.register_buffer(name, values, persistent=False)

    def forward(self, camera: Tensor) -> Moving:
        """camera: uint8 [B, 3, H, W] -> cells of `far_size`, row 0 farthest ahead"""
        band = camera[:, :, slice(*self.rows), slice(*self.columns)]
        seen = self.eyes((band.float() - self.pixel_mean) / self.pixel_spread)
        places = self.places.expand(camera.shape[0], -1, -1)
        found = lookup(seen.permute(0, 2, 3, 1), places)
        found = found.unflatten(1, (len(LOOKED_AT), -1, self.breadth)).permute(0, 1, 4, 2, 3)
        ground = self.ground.expand(camera.shape[0], -1, -1, -1)
        x = F.relu(self.lift(torch.cat([found.flatten(1, 2), ground], 1)))
        for layer in self.around:
            x = x + F.relu(layer(x))
        told = self.tell(x).unflatten(1, (3, DEPTH)).transpose(2, 3).flatten(2, 3)
        return Moving(told[:, 0], UNITS * told[:, 1:])

    def _places(self, ground: Tensor, config: TransfuserConfig) -> Tensor:
        """[1, Z R C, 2]: column and row from -1 to 1 of the band where places [R, C, 2] appear."""
        seen = [FRONT_CAMERA.pixels(ground, z, config) for z in LOOKED_AT]
        places = [
            torch.stack([within(column, self.columns), within(row, self.rows)], -1)
            for column, row in seen
        ]
        return torch.stack(places).flatten(0, 2)[None]


def with_far(near: Moving, far: Moving) -> Moving:
    """One map: what lies beyond the LiDAR's square before what lies in it; nobody beside it."""
    beside = (near.there.shape[-1] - far.there.shape[-1]) // 2
    there = F.pad(far.there, (beside, beside), value=NOBODY)
    velocity = F.pad(far.velocity, (beside, beside))
    return Moving(torch.cat([there, near.there], -2), torch.cat([velocity, near.velocity], -2))


def _ground(config: TransfuserConfig) -> Tensor:
    """[R, C, 2] m: the middles of places, R of which are DEPTH cells deep."""
    rows, columns = config.far_size
    cell, reach = config.upscaled_cell, config.lidar_range
    ahead = reach + cell * DEPTH * (rows // DEPTH - 0.5 - torch.arange(rows // DEPTH))
    left = cell * (columns / 2 - 0.5 - torch.arange(columns))
    return torch.stack(torch.meshgrid(ahead, left, indexing="ij"), -1)
