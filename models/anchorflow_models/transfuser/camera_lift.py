"""Camera pictures lifted onto the ground: the road ahead, and traffic beyond the LiDAR."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.blocks import PIXEL_MEAN, PIXEL_SPREAD
from anchorflow_models.layers.places import lookup
from anchorflow_models.transfuser.config import STATUS, TransfuserConfig
from anchorflow_models.transfuser.lidar_flow import UNITS, Moving, SweepMotion

# nuPlan's cameras, in pixels of the stitched picture before it is resized.
WIDTH = 4096
FOCAL = 1545 / WIDTH
"""Focal length in widths of the stitched picture."""
AHEAD, HEIGHT = 1.7, 1.5
"""m before the rear axle and above the ground; all look along the horizon."""
NEAREST = 0.5
"""m before a camera; what is nearer, or behind it, appears as if it were there."""


@dataclass(frozen=True)
class Camera:
    """One of the three.

    yaw: rad, to the left; middle, half: of its part of the picture, in widths of the whole
    """

    yaw: float
    middle: float
    half: float

    def pixels(self, ground: Tensor, z: float, config: TransfuserConfig) -> tuple[Tensor, Tensor]:
        """Column and row [...] where places [..., 2] m appear, z m above the ground."""
        away, aside = self._from(ground)
        away = away.clamp(min=NEAREST)
        column = config.image_width * (self.middle - FOCAL * aside / away)
        # The picture is as wide as four of its heights, or is drawn as if it were.
        row = config.image_height * (0.5 + 4 * FOCAL * (HEIGHT - z) / away)
        return column, row

    def sees(self, ground: Tensor, z: float, config: TransfuserConfig) -> Tensor:
        """Whether [...] its part shows places [..., 2] m, z m above the ground."""
        column, row = self.pixels(ground, z, config)
        across = (column / config.image_width - self.middle).abs() <= self.half
        away, _ = self._from(ground)
        return across & (row >= 0) & (row <= config.image_height) & (away > NEAREST)

    def _from(self, ground: Tensor) -> tuple[Tensor, Tensor]:
        """Distances [...] m of places ahead of the camera, and to its left."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        ahead, left = ground[..., 0] - AHEAD, ground[..., 1]
        return cos * ahead + sin * left, cos * left - sin * ahead


_SIDE, _HALF = 544 / WIDTH, 960 / WIDTH
SIDE_YAW = math.radians(55.0)
FRONT_CAMERA = Camera(0.0, 0.5, _HALF)
CAMERAS = (FRONT_CAMERA, Camera(SIDE_YAW, _SIDE, _SIDE), Camera(-SIDE_YAW, 1 - _SIDE, _SIDE))


def in_picture(ground: Tensor, z: float, config: TransfuserConfig) -> tuple[Tensor, Tensor, Tensor]:
    """Column and row [...] where places [..., 2] m appear, z m above the ground, by the first of
    the cameras that sees them, and whether [...] any does.
    """
    first, *others = CAMERAS
    (column, row), seen = first.pixels(ground, z, config), first.sees(ground, z, config)
    for camera in others:
        sees = camera.sees(ground, z, config) & ~seen
        its_column, its_row = camera.pixels(ground, z, config)
        column, row = its_column.where(sees, column), its_row.where(sees, row)
        seen = seen | sees
    return column, row, seen


def span(share: tuple[float, float], size: int) -> tuple[int, int]:
    """Return the first and the end pixel of a share of `size` pixels."""
    return round(share[0] * size), round(share[1] * size)


def within(pixel: Tensor, span: tuple[int, int]) -> Tensor:
    """Pixels as -1 to 1 of a span of them."""
    first, end = span
    return (2 * pixel - first - end) / (end - first)


GROUND_WIDTH = 48
"""Channels of what `GroundSight` makes of a place."""
GROUND_DILATIONS = (1, 2, 4, 8, 2, 1)
FAR_WIDTH, FAR_DILATIONS = 48, (1, 2, 4, 1)
EYES = 32  # channels of the picture's features
DEPTH = 2  # cells one behind the other that are predicted by one place
NOBODY = -20.0
"""The logit of cells out of sight."""


class CameraLift(nn.Module):
    """Features of a band of the picture, looked up where places on the ground appear in it.

    Simple-BEV (arXiv 2206.07959) lifts pictures in this way.
    band, front: shares of the picture's rows and columns; heights: m above the ground of a place
    """

    places: Tensor
    pixel_mean: Tensor
    pixel_spread: Tensor
    eyes: nn.Sequential

    def __init__(
        self,
        config: TransfuserConfig,
        *,
        band: tuple[float, float],
        front: tuple[float, float],
        heights: tuple[float, ...],
    ) -> None:
        super().__init__()
        self.rows, self.columns = span(band, config.image_height), span(front, config.image_width)
        self.heights = heights
        for name, values in (("pixel_mean", PIXEL_MEAN), ("pixel_spread", PIXEL_SPREAD)):
            self.register_buffer(name, 255 * torch.tensor(values)[:, None, None], persistent=False)

    def lifted(self, camera: Tensor, size: tuple[int, int]) -> Tensor:
        """camera: uint8 [B, 3, H, W] -> [B, heights, EYES, rows, columns] of places of that size"""
        band = camera[:, :, slice(*self.rows), slice(*self.columns)]
        seen = self.eyes((band.float() - self.pixel_mean) / self.pixel_spread)
        found = lookup(seen.permute(0, 2, 3, 1), self.places.expand(camera.shape[0], -1, -1))
        return found.unflatten(1, (len(self.heights), *size)).permute(0, 1, 4, 2, 3)

    def band_places(self, column: Tensor, row: Tensor) -> Tensor:
        """Columns and rows [...] in pixels as [..., 2] from -1 to 1 of the band."""
        return torch.stack([within(column, self.columns), within(row, self.rows)], -1)


class GroundSight(CameraLift):
    """The road ahead, by the stitched picture and the LiDAR's BEV.

    Lines and kerbs are narrower than the cells of the backbone's BEV, whose picture is pooled to
    tokens of whole parts of it; and the road continues beyond the LiDAR's square.
    """

    ground: Tensor
    seen: Tensor

    def __init__(self, config: TransfuserConfig) -> None:
        super().__init__(config, band=(0.4375, 1.0), front=(0.0, 1.0), heights=(0.0, 1.0))
        self.size = config.upscaled_size
        self.eyes = nn.Sequential(
            nn.Conv2d(3, 24, 5, 2, 2),
            nn.ReLU(),
            nn.Conv2d(24, EYES, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(EYES, EYES, 3, padding=1),
            nn.ReLU(),
        )
        known = len(self.heights) * (EYES + 1) + config.bev_channels + 2
        self.lift = nn.Conv2d(known, GROUND_WIDTH, 1)
        self.status = nn.Linear(STATUS, GROUND_WIDTH)
        self.around = nn.ModuleList(
            nn.Conv2d(GROUND_WIDTH, GROUND_WIDTH, 3, padding=each, dilation=each)
            for each in GROUND_DILATIONS
        )
        for name, values in zip(("places", "seen", "ground"), self._places(config), strict=True):
            self.register_buffer(name, values, persistent=False)

    def forward(self, camera: Tensor, bev: Tensor, status: Tensor) -> Tensor:
        """camera: uint8 [B, 3, H, W]; bev: [B, C', h, h] of the square that lies `ground_ahead`;
        status: [B, 8] in its units -> [B, GROUND_WIDTH, h, h] likewise, row 0 farthest ahead"""
        found = self.lifted(camera, (self.size, self.size)) * self.seen[:, None]
        told = torch.cat([self.ground, self.seen]).expand(camera.shape[0], -1, -1, -1)
        x = self.lift(torch.cat([found.flatten(1, 2), bev, told], 1))
        x = F.relu(x + self.status(status)[:, :, None, None])
        for layer in self.around:
            x = x + F.relu(layer(x))
        return x

    def _places(self, config: TransfuserConfig) -> tuple[Tensor, Tensor, Tensor]:
        """Column and row from -1 to 1 of the band where cells appear [1, Z h h, 2]; whether any
        camera sees them [Z, h, h]; their places in units of their square [2, h, h].
        """
        size, cell = self.size, config.upscaled_cell
        steps = cell * (size / 2 - 0.5 - torch.arange(size))
        x, y = torch.meshgrid(steps + config.ground_ahead, steps, indexing="ij")
        ground = torch.stack([x, y], -1)
        places, seen = [], []
        for z in self.heights:
            column, row, sees = in_picture(ground, z, config)
            places.append(self.band_places(column, row))
            seen.append(sees.float())
        where = torch.stack([x - config.ground_ahead, y]) / config.lidar_range
        return torch.stack(places).flatten(0, 2)[None].clamp(-2, 2), torch.stack(seen), where


def moved_ahead(bev: Tensor, rows: int) -> Tensor:
    """Shift a BEV [B, C, h, h] to a square `rows` farther ahead, zero in unknown rows."""
    return F.pad(bev[:, :, : bev.shape[2] - rows], (0, 0, rows, 0))


class FarSight(CameraLift):
    """Traffic beyond the LiDAR's square, by the front camera.

    It predicts occupancy and velocity of places from one picture.
    """

    ground: Tensor

    def __init__(self, config: TransfuserConfig) -> None:
        # The band about the horizon, and the front camera's part with a little beside it.
        super().__init__(config, band=(0.375, 0.625), front=(0.25, 0.75), heights=(0.0, 0.8, 1.6))
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
        self.lift = nn.Conv2d(len(self.heights) * EYES + 2, FAR_WIDTH, 1)
        self.around = nn.ModuleList(
            nn.Conv2d(FAR_WIDTH, FAR_WIDTH, 3, padding=each, dilation=each)
            for each in FAR_DILATIONS
        )
        self.tell = nn.Conv2d(FAR_WIDTH, 3 * DEPTH, 1)
        ground = _far_ground(config)
        seen = [FRONT_CAMERA.pixels(ground, z, config) for z in self.heights]
        places = torch.stack([self.band_places(*pixels) for pixels in seen])
        self.register_buffer("places", places.flatten(0, 2)[None], persistent=False)
        units = torch.stack([ground[..., 0] / 100, ground[..., 1] / 30])
        self.register_buffer("ground", units, persistent=False)

    def forward(self, camera: Tensor) -> Moving:
        """camera: uint8 [B, 3, H, W] -> cells of `far_size`, row 0 farthest ahead"""
        found = self.lifted(camera, (self.depth // DEPTH, self.breadth))
        ground = self.ground.expand(camera.shape[0], -1, -1, -1)
        x = F.relu(self.lift(torch.cat([found.flatten(1, 2), ground], 1)))
        for layer in self.around:
            x = x + F.relu(layer(x))
        told = self.tell(x).unflatten(1, (3, DEPTH)).transpose(2, 3).flatten(2, 3)
        return Moving(told[:, 0], UNITS * told[:, 1:])


def with_far(near: Moving, far: Moving) -> Moving:
    """Join both maps: the far one ahead of the LiDAR's square, empty at its sides."""
    beside = (near.there.shape[-1] - far.there.shape[-1]) // 2
    there = F.pad(far.there, (beside, beside), value=NOBODY)
    velocity = F.pad(far.velocity, (beside, beside))
    return Moving(torch.cat([there, near.there], -2), torch.cat([velocity, near.velocity], -2))


def foretold_traffic(
    sweeps: SweepMotion | None,
    far: FarSight | None,
    sensors: tuple[Tensor, Tensor, Tensor | None],
    upscaled: Tensor,
    times: Sequence[float],
) -> tuple[Moving | None, Moving | None, Tensor | None]:
    """Others near by and far ahead, and the share of each cell that they take at times [s].

    sensors: camera, lidar and lidar_before, as the backbone takes them; upscaled: its BEV
    All three are None without `sweeps` and `far`.
    """
    if sweeps is None or far is None:
        return None, None, None
    camera, lidar, before = sensors
    before = torch.zeros_like(lidar) if before is None else before
    moving, beyond = sweeps(lidar, before, upscaled), far(camera)
    return moving, beyond, sweeps.foretold(with_far(moving, beyond), times)


def _far_ground(config: TransfuserConfig) -> Tensor:
    """[R, C, 2] m: the middles of places, R of which are DEPTH cells deep."""
    rows, columns = config.far_size
    cell, reach = config.upscaled_cell, config.lidar_range
    ahead = reach + cell * DEPTH * (rows // DEPTH - 0.5 - torch.arange(rows // DEPTH))
    left = cell * (columns / 2 - 0.5 - torch.arange(columns))
    return torch.stack(torch.meshgrid(ahead, left, indexing="ij"), -1)
