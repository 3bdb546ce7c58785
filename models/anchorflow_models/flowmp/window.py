"""What the network sees of the map: the scene's window, in channels of order one."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.frame import Frame
from anchorflow_models.layers.lookup import lookup_at

NEAR, FAR = 0.25, 1.0  # m, the two scales at which clearance is resolved


class MapWindow(nn.Module):
    """Resamples maps of any size to the window and scales them.

    cost_map: [B, C, H, W] in [0, 1]; clearance: [B, H, W] m
    """

    def __init__(self, map_channels: int, size: int) -> None:
        super().__init__()
        self.size = size
        self.channels = 2 + map_channels

    def forward(
        self, cost_map: Tensor, map_geometry: Tensor, clearance: Tensor, frame: Frame
    ) -> Tensor:
        """[B, 2 + C, size, size]."""
        maps = torch.cat([clearance[:, None], cost_map], 1)
        size_x, size_y = torch.full((), maps.shape[3]), torch.full((), maps.shape[2])
        begin_x, begin_y, resolution = map_geometry.split(1, 1)
        extent_x, extent_y = resolution * size_x.to(maps), resolution * size_y.to(maps)
        place_x, place_y = frame.window(self.size).unbind(-1)
        x = (place_x - begin_x) / extent_x * 2 - 1
        y = (place_y - begin_y) / extent_y * 2 - 1
        # Not grid_sample: its ONNX form is newer than what some execution providers read.
        seen = lookup_at(maps.permute(0, 2, 3, 1), x, y)
        seen = seen.transpose(1, 2).unflatten(2, (self.size, self.size))
        # Beyond the map's edge the robot's clearance goes on falling.
        beyond = (x.abs() - 1).clamp(min=0) * extent_x / 2
        beyond = beyond + (y.abs() - 1).clamp(min=0) * extent_y / 2
        metres = seen[:, :1] - beyond.unflatten(1, (1, self.size, self.size))
        return torch.cat([torch.tanh(metres / NEAR), torch.tanh(metres / FAR), seen[:, 1:]], 1)
