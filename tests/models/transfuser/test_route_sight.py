"""The camera's look at where the way leads, and how well trajectories keep to it."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from anchorflow_models.transfuser import RouteSight, route_keeping, small_transfuser

CONFIG = small_transfuser()
ROWS, COLUMNS = CONFIG.route_size
SURE, UNSURE = -4.0, 3.0


def route_sight() -> RouteSight:
    torch.manual_seed(0)
    return RouteSight(CONFIG).eval()


def pixel(x: float, y: float) -> tuple[float, float]:
    """Row and column where a point on the ground appears, of a pinhole of 1545 of 4096 pixels."""
    focal = 1545 * CONFIG.image_width / 4096
    away = x - 1.7
    return (
        CONFIG.image_height / 2 + focal * 1.5 / away,
        CONFIG.image_width / 2 - focal * y / away,
    )


def told(sight: RouteSight, camera: Tensor, *, command: int = 1) -> Tensor:
    side = CONFIG.upscaled_size
    upscaled = torch.zeros(1, CONFIG.bev_channels, side, side)
    status = torch.zeros(1, 8)
    status[0, command] = 1.0
    return sight(camera.byte(), upscaled, status)[0]


@pytest.mark.parametrize(("place", "x", "y"), [((0, 0), 47.5, 15.5), ((40, 18), 7.5, -2.5)])
def test_places_are_looked_up_where_they_appear(place: tuple[int, int], x: float, y: float) -> None:
    column, row = route_sight().places.reshape(ROWS, COLUMNS, 2)[place]
    top, left = CONFIG.image_height * 7 / 16, CONFIG.image_width / 4
    found = (
        top + (float(row) + 1) / 2 * CONFIG.image_height * 9 / 16,
        left + (float(column) + 1) / 2 * CONFIG.image_width / 2,
    )
    assert found == pytest.approx(pixel(x, y), abs=1e-3)


@torch.inference_mode()
def test_what_the_camera_does_not_see_is_not_looked_up() -> None:
    seen = route_sight().seen
    assert seen[0].all()  # far ahead the picture is wide enough
    assert not seen[-1].any()  # under the bonnet
    assert not seen[-8, [0, -1]].any()


@torch.inference_mode()
def test_a_line_on_the_left_and_the_command_are_heard() -> None:
    sight, plain = route_sight(), torch.full((1, 3, CONFIG.image_height, CONFIG.image_width), 90)
    lined = plain.clone()
    row, column = (round(each) for each in pixel(12.0, 5.0))
    lined[:, :, row - 1 : row + 2, column - 4 : column + 4] = 255
    apart = (told(sight, lined) - told(sight, plain))[0].abs()
    assert apart[:, : COLUMNS // 2].max() > apart[:, -4:].max() > -1.0
    assert apart.max() > 1e-3
    turned = told(sight, plain, command=0) - told(sight, plain)
    assert turned.abs().max() > 1e-3


def field(spread: float) -> Tensor:
    """A way straight ahead: places lie as far aside of it as of the ego's line."""
    left = COLUMNS / 2 - 0.5 - torch.arange(COLUMNS, dtype=torch.float32)
    aside = left.expand(1, 1, ROWS, -1)
    return torch.cat([aside, torch.full_like(aside, spread)], 1)


def straight(aside: float, *, ahead: float = 4.0) -> Tensor:
    """One trajectory [1, 1, 8, 2] of steps so long, so far to the left."""
    x = ahead * torch.arange(1, 9)
    return torch.stack([x, torch.full_like(x, aside)], -1)[None, None]


def kept(aside: float, *, spread: float = SURE, ahead: float = 4.0) -> float:
    return float(route_keeping(field(spread), straight(aside, ahead=ahead), cell=1.0))


def test_keeping_falls_with_the_distance_to_either_side() -> None:
    assert kept(0.0) == 1.0
    for aside in (1.2, -1.2):
        assert kept(aside) == pytest.approx(math.exp(-1.0), rel=1e-3)
    assert kept(2.2) == pytest.approx(math.exp(-2.0), rel=1e-3)


def test_where_the_way_is_not_known_little_hangs_on_it() -> None:
    assert kept(0.0, spread=UNSURE) - kept(2.0, spread=UNSURE) < 0.01
    assert kept(0.0, spread=0.0) - kept(2.0, spread=0.0) > 0.2


def test_what_lies_beyond_the_cells_counts_for_nothing() -> None:
    assert kept(1.2, ahead=20.0) == pytest.approx(kept(1.2), rel=1e-5)
    assert kept(1.2, ahead=60.0) == 1.0
    assert kept(40.0) == 1.0
