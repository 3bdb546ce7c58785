"""Where places on the ground appear in the stitched picture of NAVSIM's three cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from anchorflow_models.transfuser.config import TransfuserConfig

# nuPlan's cameras, in pixels of the stitched picture before it is resized.
WIDTH = 4096
FOCAL = 1545 / WIDTH
"""In widths of the stitched picture."""
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
        """[...]: whether places [..., 2] m, z m above the ground, lie in its part."""
        column, row = self.pixels(ground, z, config)
        across = (column / config.image_width - self.middle).abs() <= self.half
        away, _ = self._from(ground)
        return across & (row >= 0) & (row <= config.image_height) & (away > NEAREST)

    def _from(self, ground: Tensor) -> tuple[Tensor, Tensor]:
        """m [...] that places lie before the camera, and to its left."""
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
    """First and end of a share of so many pixels."""
    return round(share[0] * size), round(share[1] * size)


def within(pixel: Tensor, span: tuple[int, int]) -> Tensor:
    """Pixels as -1 to 1 of a span of them."""
    first, end = span
    return (2 * pixel - first - end) / (end - first)
