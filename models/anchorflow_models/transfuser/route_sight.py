"""Where the commanded way leads, by the front camera: how far each place lies aside of it."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.lookup import lookup
from anchorflow_models.layers.pixels import PIXEL_MEAN, PIXEL_SPREAD
from anchorflow_models.transfuser.config import TransfuserConfig
from anchorflow_models.transfuser.far_sight import AHEAD, FOCAL, FRONT, HEIGHT
from anchorflow_models.transfuser.status import STATUS_UNITS

BELOW = (0.4375, 1.0)
"""Of the picture's rows: the ground, from the horizon on."""
EYES, WIDTH, DILATIONS = 24, 48, (1, 2, 4, 8, 2, 1)
TOLD = 5
"""Of the ego status, its first: the command, and the speed."""
NEAREST = 0.5  # m before the camera
UPSCALED_UNIT = 4.0
LOG_SPREAD = (-4.0, 3.0)
KEPT = 0.2  # m aside that are as good as none
ASIDE = 1.0  # m more, over which a trajectory's keeping falls by e


class RouteSight(nn.Module):
    """The front camera's picture, looked up where places on the ground appear in it, beside what
    the backbone's BEV shows there.

    Painted lines are a few pixels of the picture and less than a cell of the BEV, which by its own
    losses knows where one can drive and not where lanes lie.
    """

    places: Tensor
    ground: Tensor
    seen: Tensor
    pixel_mean: Tensor
    pixel_spread: Tensor
    units: Tensor

    def __init__(self, config: TransfuserConfig) -> None:
        super().__init__()
        height, width = config.image_height, config.image_width
        self.top, self.left = round(BELOW[0] * height), round(FRONT[0] * width)
        self.right = round(FRONT[1] * width)
        self.size, side = config.route_size, config.upscaled_size
        self.half, self.beside = side // 2, (side - config.route_size[1]) // 2
        self.eyes = nn.Sequential(
            nn.Conv2d(3, 16, 5, padding=2),
            nn.ReLU(),
            nn.Conv2d(16, EYES, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(EYES, EYES, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(EYES, EYES, 3, padding=1),
            nn.ReLU(),
        )
        self.lift = nn.Conv2d(EYES + 3 + TOLD + config.bev_channels, WIDTH, 1)
        self.around = nn.ModuleList(
            nn.Conv2d(WIDTH, WIDTH, 3, padding=each, dilation=each) for each in DILATIONS
        )
        self.tell = nn.Conv2d(WIDTH, 2, 1)
        x, y = _ground(config)
        away = x - AHEAD
        column = width / 2 - FOCAL * width * y / away - self.left
        # The picture is as wide as four of its heights, or is drawn as if it were.
        row = height / 2 + FOCAL * 4 * height * HEIGHT / away - self.top
        columns, rows = self.right - self.left, height - self.top
        seen = (away > NEAREST) & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        within = torch.stack([(2 * column - columns) / columns, (2 * row - rows) / rows], -1)
        for name, values in (
            ("places", within.nan_to_num().clamp(-2, 2).flatten(0, 1)[None]),
            ("ground", torch.stack([x / 40, y / 16, seen.float()])),
            ("seen", seen.float()),
            ("pixel_mean", 255 * torch.tensor(PIXEL_MEAN)[:, None, None]),
            ("pixel_spread", 255 * torch.tensor(PIXEL_SPREAD)[:, None, None]),
            ("units", torch.tensor(STATUS_UNITS[:TOLD])),
        ):
            self.register_buffer(name, values, persistent=False)

    def forward(self, camera: Tensor, upscaled: Tensor, ego_status: Tensor) -> Tensor:
        """camera: uint8 [B, 3, H, W]; upscaled: [B, C', h, h]; ego_status: [B, 8] -> [B, 2, R, C]:
        m that cells of `route_size` lie to the left of the way, and the log of how wrong that is
        (Laplace); row 0 lies farthest ahead, column 0 farthest left
        """
        picture = camera[:, :, self.top :, self.left : self.right].float()
        eyed = self.eyes((picture - self.pixel_mean) / self.pixel_spread)
        batch = camera.shape[0]
        found = lookup(eyed.permute(0, 2, 3, 1), self.places.expand(batch, -1, -1))
        found = found.unflatten(1, self.size).permute(0, 3, 1, 2) * self.seen
        ahead = upscaled[:, :, : self.half, self.beside : self.beside + self.size[1]]
        ahead = F.pad(ahead / UPSCALED_UNIT, (0, 0, self.size[0] - self.half, 0))
        told = (ego_status[:, :TOLD] / self.units)[:, :, None, None].expand(-1, -1, *self.size)
        ground = self.ground.expand(batch, -1, -1, -1)
        x = F.relu(self.lift(torch.cat([found, ground, told, ahead], 1)))
        for layer in self.around:
            x = x + F.relu(layer(x))
        return self.tell(x)


def route_keeping(aside: Tensor, points: Tensor, *, cell: float) -> Tensor:
    """How well trajectories keep to the way [B, M], in [0, 1]: 1 where none of them lies aside of
    it, falling by e with each metre of the mean.

    What is to be expected of the distance counts, so where the way is not known nothing does.

    aside: [B, 2, R, C] as `RouteSight` tells it; points: [B, M, T, 2] m; cell: m, a side of a cell
    """
    rows, columns = (int(size) for size in aside.shape[-2:])
    x, y = points[..., 0] / (rows * cell), points[..., 1] / (columns * cell)
    inside = ((x <= 1) & (2 * y.abs() <= 1)).to(points.dtype)
    places = torch.stack([-2 * y, 1 - 2 * x], -1).flatten(1, 2)
    found = lookup(aside.permute(0, 2, 3, 1), places).unflatten(1, points.shape[1:3])
    mean, spread = found[..., 0].abs(), found[..., 1].clamp(*LOG_SPREAD).exp()
    expected = mean + spread * (-mean / spread).exp()
    average = (expected * inside).sum(-1) / inside.sum(-1).clamp(min=1.0)
    return (-(average - KEPT).clamp(min=0.0) / ASIDE).exp()


def _ground(config: TransfuserConfig) -> tuple[Tensor, Tensor]:
    """[R, C] m each: x and y of the middles of cells of `route_size`."""
    rows, columns = config.route_size
    cell = config.upscaled_cell
    ahead = cell * (rows - 0.5 - torch.arange(rows))
    left = cell * (columns / 2 - 0.5 - torch.arange(columns))
    x, y = torch.meshgrid(ahead, left, indexing="ij")
    return x, y
