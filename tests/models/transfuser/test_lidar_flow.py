"""What two sweeps of the LiDAR say of who moves, and what follows."""

from __future__ import annotations

import pytest
import torch
from small_configs import BACKBONE
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.transfuser import Moving, SweepMotion
from anchorflow_models.transfuser.lidar_flow import EYES, SEARCHED, correlation, foretold

SIDE = 2 * SEARCHED + 1


def test_each_displacement_has_the_product_of_its_cells() -> None:
    generator = torch.Generator().manual_seed(0)
    now, before = torch.randn(2, 2, 3, 7, 7, generator=generator)

    found = correlation(now, before)

    assert found.shape == (2, SIDE**2, 7, 7)
    for row, column in ((0, 0), (3, 0), (-2, 4), (-SEARCHED, SEARCHED)):
        place = (row + SEARCHED) * SIDE + column + SEARCHED
        for here in ((0, 0), (3, 2), (6, 5)):
            y, x = here[0] + row, here[1] + column
            inside = 0 <= y < 7 and 0 <= x < 7
            other = before[:, :, y, x] if inside else torch.zeros(2, 3)
            wanted = (now[:, :, here[0], here[1]] * other).sum(1)
            torch.testing.assert_close(found[:, place, here[0], here[1]], wanted)


class Struck(nn.Module):
    """A sweep's hits on every channel."""

    def __init__(self, stride: int) -> None:
        super().__init__()
        self.stride = stride

    def forward(self, x: Tensor) -> Tensor:
        return F.avg_pool2d(x, self.stride).expand(-1, EYES, -1, -1)


def test_a_car_that_came_from_behind_drives_forward() -> None:
    motion = SweepMotion(BACKBONE)
    motion.eyes, motion.key = Struck(4), Struck(2)  # type: ignore[assignment]
    with torch.no_grad():
        for parameter in motion.more.parameters():
            parameter.zero_()
        motion.sharpness.fill_(200.0)
    # As the LiDAR's histogram has it: row 0 farthest behind, cells of 0.25 m.
    now, before = torch.zeros(2, 1, 1, 256, 256)
    now[..., 160:168, 120:128] = 1.0
    before[..., 152:160, 128:136] = 1.0  # half a second ago 2 m farther behind and to the left

    moving = motion(now, before, torch.zeros(1, 32, 64, 64))

    row, column = 63 - 164 // 4, 63 - 124 // 4  # row 0 farthest ahead, column 0 farthest left
    torch.testing.assert_close(moving.velocity[0, :, row, column], torch.tensor([4.0, -4.0]))


def test_others_are_foretold_where_their_velocity_takes_them() -> None:
    there, velocity = torch.zeros(1, 9, 9), torch.zeros(1, 2, 9, 9)
    there[0, 6, 4], velocity[0, :, 6, 4] = 0.75, torch.tensor([2.0, 1.0])  # cells a second

    found = foretold(there, velocity, (0.0, 1.0, 2.0, 4.0))[0]

    for time, (row, column) in enumerate([(6, 4), (4, 3), (2, 2)]):
        assert found[time, row, column] == 0.75
        assert found[time].sum() == 0.75
    assert not found[3].any()  # beyond the edge


def test_a_cell_is_taken_once_at_most() -> None:
    there, velocity = torch.ones(1, 5, 5), torch.zeros(1, 2, 5, 5)
    velocity[0, 1, 2] = torch.arange(5.0) - 2.0  # all of a row into its middle
    assert foretold(there, velocity, (1.0,)).max() == 1.0


def test_later_is_less_certain() -> None:
    motion = SweepMotion(BACKBONE)
    there, velocity = torch.full((1, 64, 64), -20.0), torch.zeros(1, 2, 64, 64)
    there[0, 32, 32] = 20.0

    soon, late = motion.foretold(Moving(there, velocity), [0.5 * k for k in range(1, 9)])[0, [0, 7]]

    assert soon[32, 32] > 2 * late[32, 32] > 0
    assert soon.sum() == pytest.approx(float(late.sum()), rel=1e-3)
