"""The camera's look at what is farther ahead than the LiDAR sees."""

from __future__ import annotations

import pytest
import torch
from small_configs import BACKBONE as CONFIG

from anchorflow_models.transfuser import FarSight, Moving, with_far

ROWS, COLUMNS = CONFIG.far_size


def far_sight() -> FarSight:
    torch.manual_seed(0)
    return FarSight(CONFIG).eval()


def pixel(x: float, y: float, z: float) -> tuple[float, float]:
    """Row and column where a point (m) appears, of a pinhole of 1545 of 4096 pixels."""
    focal = 1545 * CONFIG.image_width / 4096
    away = x - 1.7
    return CONFIG.image_height / 2 + focal * (1.5 - z) / away, (
        CONFIG.image_width / 2 - focal * y / away
    )


@pytest.mark.parametrize(("place", "x", "y"), [((0, 0), 71.0, 19.5), ((19, 30), 33.0, -10.5)])
@pytest.mark.parametrize(("height", "z"), [(0, 0.0), (2, 1.6)])
def test_places_are_looked_up_where_they_appear(
    place: tuple[int, int], x: float, y: float, height: int, z: float
) -> None:
    sight = far_sight()
    column, row = sight.places.reshape(3, ROWS // 2, COLUMNS, 2)[height, place[0], place[1]]
    first_row, first_column = CONFIG.image_height * 3 / 8, CONFIG.image_width / 4
    found = (
        first_row + (float(row) + 1) / 2 * CONFIG.image_height / 4,
        first_column + (float(column) + 1) / 2 * CONFIG.image_width / 2,
    )
    assert found == pytest.approx(pixel(x, y, z), abs=1e-3)


@torch.inference_mode()
def test_what_appears_on_the_left_is_told_on_the_left() -> None:
    sight, empty = far_sight(), torch.full((1, 3, CONFIG.image_height, CONFIG.image_width), 120)
    car = empty.clone()
    low, left = (round(each) for each in pixel(40.0, 14.0, 0.0))
    car[:, :, low - 8 : low, left - 3 : left + 3] = 0
    apart = (sight(car.byte()).there - sight(empty.byte()).there)[0].abs()
    # Convolutions carry it some cells aside, not over to the other side.
    assert apart[:, : COLUMNS // 2].max() > 1e-3
    assert apart[:, -8:].max() == 0.0


@torch.inference_mode()
def test_the_sky_and_the_bonnet_tell_nothing() -> None:
    sight, camera = far_sight(), torch.zeros(1, 3, CONFIG.image_height, CONFIG.image_width).byte()
    other = camera.clone()
    other[:, :, : CONFIG.image_height // 4] = 255
    other[:, :, -CONFIG.image_height // 4 :] = 255
    torch.testing.assert_close(sight(other).there, sight(camera).there)


def test_one_map_of_what_is_near_and_far() -> None:
    near = Moving(torch.full((1, 64, 64), 2.0), torch.full((1, 2, 64, 64), 3.0))
    far = Moving(torch.full((1, ROWS, COLUMNS), 4.0), torch.full((1, 2, ROWS, COLUMNS), 5.0))
    both = with_far(near, far)
    beside = (64 - COLUMNS) // 2
    assert both.there.shape == (1, ROWS + 64, 64)
    assert (both.there[:, ROWS:] == 2.0).all()
    assert (both.there[:, :ROWS, beside:-beside] == 4.0).all()
    assert both.there[:, :ROWS, :beside].sigmoid().max() < 1e-6
    assert (both.velocity[:, :, :ROWS, beside:-beside] == 5.0).all()
    assert (both.velocity[:, :, :ROWS, -beside:] == 0.0).all()
