"""Clearance as a differentiable function of position."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_models.layers.places import lookup


@dataclass(frozen=True, eq=False)
class ClearanceMap:
    """The clearance fields of B scenes, interpolated bilinearly: `GridField` in torch.

    values: [B, H, W] m beyond the robot's radius at cell centres
    geometry: [B, 3], origin x, origin y in m, resolution in m/cell
    """

    values: Tensor
    geometry: Tensor

    def __call__(self, points: Tensor) -> Tensor:
        """Clearance [B, ...] m at points [B, ..., D >= 2] in m.

        Beyond the outermost cell centres it falls by one metre a metre.
        """
        flat = points[..., :2].flatten(1, -2)
        origin, resolution = self.geometry[:, None, :2], self.geometry[:, None, 2:]
        _, height, width = self.values.shape
        size = torch.tensor([width, height], dtype=flat.dtype, device=flat.device)
        cells = (flat - origin) / resolution
        values = lookup(self.values[..., None], 2 * cells / size - 1)[..., 0]
        beyond = (0.5 - cells).clamp(min=0) + (cells - size + 0.5).clamp(min=0)
        clearance = values - beyond.sum(-1) * self.geometry[:, 2:]
        return clearance.reshape(points.shape[:-1])
