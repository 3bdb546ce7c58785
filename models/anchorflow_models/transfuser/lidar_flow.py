"""How fast the others move, by what two sweeps of the LiDAR struck, and where they will be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.geometry import in_float32
from anchorflow_models.transfuser.config import SEMANTIC_STRIDE, TransfuserConfig

APART_S = 0.5
"""s between the two sweeps."""
SEARCHED = 4
"""Coarse cells, two of the upscaled BEV a side, within which what was seen before is looked for."""
EYES, COARSE, WIDTH = 32, 64, 48  # channels
DILATIONS = ((1, 2), (1, 2, 1, 4, 1))  # of the convolutions over coarse cells, and over fine ones
SHARPNESS = 2.0  # of the best match, to begin with
WIDER_S = 1.5
"""Interval after which predictions are blurred by another cell."""
UNITS = 4.0  # m/s, of what is added to the best match


@dataclass(frozen=True, eq=False)
class Moving:
    """Occupancy and velocity of cells of the upscaled BEV, row 0 farthest ahead, column 0 farthest
    left.

    there: [B, h, w] logits of occupancy by others
    velocity: [B, 2, h, w] m/s, forward and to the left, of what is there
    """

    there: Tensor
    velocity: Tensor


class SweepMotion(nn.Module):
    """Optical flow between two sweeps (the correlation layer of FlowNet, arXiv 1504.06852, eq. 1).

    Velocities are predicted from the sweeps alone, which show that something moves and not where
    things usually do; who is there is also read off the upscaled BEV, which has seen the camera.
    """

    displacements: Tensor

    def __init__(self, config: TransfuserConfig) -> None:
        super().__init__()
        stride = SEMANTIC_STRIDE
        self.cell = 2 * config.lidar_range / config.upscaled_size
        self.eyes = nn.Sequential(
            nn.Conv2d(1, EYES, 2 * stride, stride, stride // 2),
            nn.ReLU(),
            _around(EYES, EYES),
            nn.ReLU(),
            _around(EYES, EYES),
            nn.ReLU(),
        )
        self.key = nn.Conv2d(EYES, EYES, 4, 2, 1)
        self.match = nn.Conv2d((2 * SEARCHED + 1) ** 2 + 2 * EYES, COARSE, 1)
        coarse, fine = DILATIONS
        self.coarse = nn.ModuleList(_around(COARSE, COARSE, each) for each in coarse)
        self.finer = nn.Conv2d(COARSE, WIDTH, 1)
        self.join = _around(WIDTH + 2 + 2 * EYES, WIDTH)
        self.fine = nn.ModuleList(_around(WIDTH, WIDTH, each) for each in fine)
        self.more = nn.Conv2d(WIDTH, 2, 1)
        self.there = nn.Sequential(
            _around(WIDTH + config.bev_channels, EYES), nn.ReLU(), nn.Conv2d(EYES, 1, 1)
        )
        self.sharpness = nn.Parameter(torch.tensor(SHARPNESS))
        cells = torch.arange(-SEARCHED, SEARCHED + 1, dtype=torch.float32)
        places = torch.stack(torch.meshgrid(cells, cells, indexing="ij")).flatten(1)
        self.register_buffer("displacements", places, persistent=False)

    def forward(self, lidar: Tensor, lidar_before: Tensor, upscaled: Tensor) -> Moving:
        """lidar, lidar_before: [B, 1, H, H] as the backbone takes them; upscaled: [B, C', h, h]"""
        seen = [self.eyes(sweep.flip(-2, -1)) for sweep in (lidar, lidar_before)]
        keys = [self.key(each) for each in seen]
        likeness = correlation(*keys) / EYES**0.5
        share = (self.sharpness * likeness).softmax(1)
        # Displacements point to the earlier place; rows count backward and columns to the right.
        moved = _expected(share, self.displacements)
        best = moved * (2 * self.cell / APART_S)
        x = F.relu(self.match(torch.cat([likeness, *keys], 1)))
        for layer in self.coarse:
            x = x + F.relu(layer(x))
        finer = F.interpolate(torch.cat([self.finer(x), best], 1), scale_factor=2.0)
        x = F.relu(self.join(torch.cat([finer, *seen], 1)))
        for layer in self.fine:
            x = x + F.relu(layer(x))
        there = self.there(torch.cat([x, upscaled], 1))
        return Moving(there[:, 0], finer[:, WIDTH:] + UNITS * self.more(x))

    def foretold(self, moving: Moving, times: Sequence[float]) -> Tensor:
        """[B, T, h, w]: the share of a cell that is taken at these times [s], which ascend, at
        constant velocity.

        Later maps are blurred more, since velocities change.
        """
        maps = foretold(moving.there.sigmoid(), moving.velocity / self.cell, times)
        for wider in range(1, int(times[-1] / WIDER_S) + 1):
            sooner = sum(time < wider * WIDER_S for time in times)
            later = F.avg_pool2d(maps[:, sooner:], 3, 1, 1)
            maps = torch.cat([maps[:, :sooner], later], 1)
        return maps


def _around(inputs: int, outputs: int, dilation: int = 1) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=dilation, dilation=dilation)


@in_float32
def _expected(share: Tensor, displacements: Tensor) -> Tensor:
    """The mean [B, 2, h, w] of displacements [2, D] by shares [B, D, h, w]."""
    return torch.einsum("bdhw,kd->bkhw", share, displacements)


def correlation(now: Tensor, before: Tensor) -> Tensor:
    """Products [B, D, h, h] of what each cell shows now and of what the cell that is displaced by
    each of D displacements, row by row, showed before; both: [B, C, h, h]
    """
    size, side = int(now.shape[-1]), 2 * SEARCHED + 1
    padded = F.pad(before, (SEARCHED,) * 4)
    rows = torch.stack([padded[:, :, row : row + size] for row in range(side)], 1)
    # Of each row and displacement of rows, every column by every column: those that lie within
    # reach stand in a band along the diagonal, which rows one longer set upright.
    products = now.permute(0, 2, 3, 1)[:, None] @ rows.permute(0, 1, 3, 2, 4)
    longer = F.pad(products.flatten(-2), (0, size))
    band = longer.unflatten(-1, (size, size + side))[..., :side]
    return band.permute(0, 1, 4, 2, 3).flatten(1, 2)


def foretold(there: Tensor, velocity: Tensor, times: Sequence[float]) -> Tensor:
    """Cells that are taken [B, h, w] in [0, 1], moved by velocities [B, 2, h, w] in cells a
    second, forward and to the left: [B, T, h, w]. Each is shared by the four cells that it lands
    between; what lands in one adds up, to 1 at most.
    """
    height, width = there.shape[-2:]
    rows, columns, later = (
        torch.as_tensor(each, dtype=there.dtype, device=there.device)
        for each in (range(height), range(width), times)
    )
    passed = later[:, None, None]
    row = rows[:, None] - passed * velocity[:, :1]
    column = columns - passed * velocity[:, 1:]
    above, before = row.floor(), column.floor()
    y, share_of_y = _both(above, row - above)
    x, share_of_x = _both(before, column - before)
    y, share_of_y = y.unsqueeze(3), share_of_y.unsqueeze(3)
    x, share_of_x = x.unsqueeze(2), share_of_x.unsqueeze(2)
    inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
    place = (y * width + x).where(inside, torch.zeros_like(y)).long().flatten(2)
    share = there[:, None, None, None] * share_of_y * share_of_x * inside
    nobody = torch.zeros_like(row).flatten(2)
    taken = nobody.scatter_add(2, place, share.flatten(2)).clamp(max=1.0)
    return taken.unflatten(-1, (height, width))


def _both(first: Tensor, past: Tensor) -> tuple[Tensor, Tensor]:
    """The two whole numbers [B, T, 2, h, w] about each place, and their shares of what lands there.

    first: [B, T, h, w] the lower ones; past: how far beyond it is, in [0, 1)
    """
    return torch.stack([first, first + 1], 2), torch.stack([1 - past, past], 2)
