"""The road ahead, by the cameras' picture and the LiDAR's BEV."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.lookup import lookup
from anchorflow_models.layers.pixels import PIXEL_MEAN, PIXEL_SPREAD
from anchorflow_models.transfuser.camera_places import in_picture, span, within
from anchorflow_models.transfuser.config import TransfuserConfig
from anchorflow_models.transfuser.status import STATUS

BAND = (0.4375, 1.0)
"""Of the picture's rows: where the ground appears, and what stands on it."""
LOOKED_AT = (0.0, 1.0)
"""m above the ground of a place, where the picture is looked up for it."""
EYES, GROUND_WIDTH, DILATIONS = 32, 48, (1, 2, 4, 8, 2, 1)


class GroundSight(nn.Module):
    """The stitched picture, looked up where places on the ground appear in it (as Simple-BEV does,
    arXiv 2206.07959), beside what the backbone makes of them, and convolved.

    Lines and kerbs are narrower than the cells of the backbone's BEV, whose picture is heard by
    tokens of whole parts of it; and the road goes on beyond the LiDAR's square.
    """

    places: Tensor
    ground: Tensor
    seen: Tensor
    pixel_mean: Tensor
    pixel_spread: Tensor

    def __init__(self, config: TransfuserConfig) -> None:
        super().__init__()
        self.rows = span(BAND, config.image_height)
        self.size = config.upscaled_size
        self.eyes = nn.Sequential(
            nn.Conv2d(3, 24, 5, 2, 2),
            nn.ReLU(),
            nn.Conv2d(24, EYES, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(EYES, EYES, 3, padding=1),
            nn.ReLU(),
        )
        known = len(LOOKED_AT) * (EYES + 1) + config.bev_channels + 2
        self.lift = nn.Conv2d(known, GROUND_WIDTH, 1)
        self.status = nn.Linear(STATUS, GROUND_WIDTH)
        self.around = nn.ModuleList(
            nn.Conv2d(GROUND_WIDTH, GROUND_WIDTH, 3, padding=each, dilation=each)
            for each in DILATIONS
        )
        places, seen, ground = self._places(config)
        for name, values in (
            ("places", places),
            ("seen", seen),
            ("ground", ground),
            ("pixel_mean", 255 * torch.tensor(PIXEL_MEAN)[:, None, None]),
            ("pixel_spread", 255 * torch.tensor(PIXEL_SPREAD)[:, None, None]),
        ):
            self.register_buffer(name, values, persistent=False)

    def forward(self, camera: Tensor, bev: Tensor, status: Tensor) -> Tensor:
        """camera: uint8 [B, 3, H, W]; bev: [B, C', h, h] of the square that lies `ground_ahead`;
        status: [B, 8] in its units -> [B, GROUND_WIDTH, h, h] likewise, row 0 farthest ahead"""
        batch = camera.shape[0]
        band = camera[:, :, slice(*self.rows)]
        picture = self.eyes((band.float() - self.pixel_mean) / self.pixel_spread)
        found = lookup(picture.permute(0, 2, 3, 1), self.places.expand(batch, -1, -1))
        found = found.unflatten(1, (len(LOOKED_AT), self.size, self.size))
        found = found.permute(0, 1, 4, 2, 3) * self.seen[:, None]
        told = torch.cat([self.ground, self.seen]).expand(batch, -1, -1, -1)
        x = self.lift(torch.cat([found.flatten(1, 2), bev, told], 1))
        x = F.relu(x + self.status(status)[:, :, None, None])
        for layer in self.around:
            x = x + F.relu(layer(x))
        return x

    def _places(self, config: TransfuserConfig) -> tuple[Tensor, Tensor, Tensor]:
        """Column and row from -1 to 1 of the band where cells appear [1, Z h h, 2]; whether any
        camera sees them [Z, h, h]; where they are, in units of their square [2, h, h]."""
        size, cell = self.size, config.upscaled_cell
        steps = cell * (size / 2 - 0.5 - torch.arange(size))
        x, y = torch.meshgrid(steps + config.ground_ahead, steps, indexing="ij")
        ground, columns = torch.stack([x, y], -1), (0, config.image_width)
        places, seen = [], []
        for z in LOOKED_AT:
            column, row, sees = in_picture(ground, z, config)
            places.append(torch.stack([within(column, columns), within(row, self.rows)], -1))
            seen.append(sees.float())
        where = torch.stack([x - config.ground_ahead, y]) / config.lidar_range
        return torch.stack(places).flatten(0, 2)[None].clamp(-2, 2), torch.stack(seen), where


def moved_ahead(bev: Tensor, rows: int) -> Tensor:
    """A BEV [B, C, h, h] of a square so many rows farther ahead; of those nothing is known."""
    return F.pad(bev[:, :, : bev.shape[2] - rows], (0, 0, rows, 0))
