"""The road ahead, looked up in the picture of three cameras."""

from __future__ import annotations

import math

import pytest
import torch
from small_configs import BACKBONE as CONFIG
from torch import Tensor

from anchorflow_driving.sensors import pinhole as simulated
from anchorflow_models.transfuser import GROUND_WIDTH, GroundSight
from anchorflow_models.transfuser.camera_lift import AHEAD, CAMERAS, FOCAL, HEIGHT

SIZE = CONFIG.upscaled_size
FRONT, LEFT, RIGHT = CAMERAS


def ground_sight() -> GroundSight:
    torch.manual_seed(0)
    return GroundSight(CONFIG).eval()


def told(sight: GroundSight, camera: Tensor, *, bev: Tensor | None = None) -> Tensor:
    bev = torch.zeros(1, CONFIG.bev_channels, SIZE, SIZE) if bev is None else bev
    return sight(camera, bev, torch.zeros(1, 8))


def grey() -> Tensor:
    return torch.full((1, 3, CONFIG.image_height, CONFIG.image_width), 120, dtype=torch.uint8)


def looked_up(sight: GroundSight, x: float, y: float) -> tuple[float, float]:
    """Row and column of the picture where it looks for the ground of a cell."""
    row, column = int(56 - x), int(32 - y)
    places = sight.places.unflatten(1, (2, SIZE, SIZE))[0, 0, row, column]
    band = 9 / 16 * CONFIG.image_height
    return (
        CONFIG.image_height - band * (1 - float(places[1])) / 2,
        (float(places[0]) + 1) / 2 * CONFIG.image_width,
    )


def pixel(x: float, y: float, *, yaw: float, middle: float) -> tuple[float, float]:
    """Row and column of the ground at x, y by a pinhole of 1545 of 4096 pixels, 1.5 m high."""
    focal = 1545 * CONFIG.image_width / 4096
    bearing, distance = math.atan2(y, x - 1.7) - yaw, math.hypot(x - 1.7, y)
    away, aside = distance * math.cos(bearing), distance * math.sin(bearing)
    column = middle * CONFIG.image_width / 4096 - focal * aside / away
    return CONFIG.image_height / 2 + focal * 1.5 / away, column


@pytest.mark.parametrize(
    ("x", "y", "yaw", "middle"),
    [
        (40.5, 3.5, 0.0, 2048),
        (9.5, -2.5, 0.0, 2048),
        (10.5, 14.5, 55.0, 544),
        (8.5, -12.5, -55.0, 4096 - 544),
    ],
)
def test_cells_are_looked_up_where_their_ground_appears(
    x: float, y: float, yaw: float, middle: float
) -> None:
    expected = pixel(x, y, yaw=math.radians(yaw), middle=middle)
    assert looked_up(ground_sight(), x, y) == pytest.approx(expected, abs=1e-3)


def test_each_camera_sees_its_own_part() -> None:
    ground = torch.tensor([[20.0, 0.0], [10.0, 14.0], [10.0, -14.0], [-5.0, 0.0], [3.0, 0.0]])
    seen = {camera: camera.sees(ground, 0.0, CONFIG).tolist() for camera in CAMERAS}
    assert seen[FRONT] == [True, False, False, False, False]  # the last below its picture
    assert seen[LEFT] == [False, True, False, False, False]
    assert seen[RIGHT] == [False, False, True, False, False]


def test_the_simulated_cameras_are_mounted_so() -> None:
    assert (AHEAD, HEIGHT) == (simulated.AHEAD, simulated.HEIGHT)
    assert [c.yaw for c in CAMERAS] == pytest.approx([0.0, simulated.SIDE_YAW, -simulated.SIDE_YAW])
    in_pixels = 1024 * FOCAL  # of a stitched picture that wide
    assert in_pixels == pytest.approx(simulated.FOCAL)


@torch.inference_mode()
def test_what_appears_on_the_left_is_told_on_the_left() -> None:
    sight, camera = ground_sight(), grey()
    row, column = (round(each) for each in pixel(30.0, 13.0, yaw=0.0, middle=2048))
    camera[:, :, row - 2 : row + 2, column - 3 : column + 3] = 0
    apart = (told(sight, camera) - told(sight, grey()))[0].abs().amax(0)
    assert apart[:, : SIZE // 2].max() > 1e-3
    assert apart.amax(0).argmax() == pytest.approx(32 - 13, abs=2)
    assert apart[:, -8:].max() == 0.0  # convolutions carry it some cells aside, not over there


@torch.inference_mode()
def test_the_sky_tells_nothing() -> None:
    sight, camera = ground_sight(), grey()
    camera[:, :, : CONFIG.image_height * 7 // 16] = 255
    torch.testing.assert_close(told(sight, camera), told(sight, grey()))


@torch.inference_mode()
def test_it_hears_the_backbone_and_the_command() -> None:
    sight = ground_sight()
    before = told(sight, grey())
    assert before.shape == (1, GROUND_WIDTH, SIZE, SIZE)
    bev = torch.zeros(1, CONFIG.bev_channels, SIZE, SIZE)
    bev[..., 10, 50] = 1.0
    apart = (told(sight, grey(), bev=bev) - before)[0].abs().amax(0)
    assert apart.argmax() == 10 * SIZE + 50
    left = torch.zeros(1, 8)
    left[:, 0] = 1.0
    assert (sight(grey(), 0 * bev, left) - before).abs().max() > 1e-3
