"""Places in the ego's frame on a raster seen from above."""

from __future__ import annotations

import torch
from torch import Tensor

from anchorflow_models.layers.places import lookup

Extent = tuple[float, float, float, float]


def at_places(cells: Tensor, places: Tensor, extent: Extent) -> Tensor:
    """Look up a raster at places: [B, H, W, F], [B, ..., 2] m -> [B, ..., F].

    extent: least and greatest x, least and greatest y; row 0 is at the greatest x, column 0 at
        the greatest y. Beyond its edge the raster repeats its last cells.
    """
    low_x, high_x, low_y, high_y = extent
    across = 1 - 2 * (places[..., 1] - low_y) / (high_y - low_y)
    down = 1 - 2 * (places[..., 0] - low_x) / (high_x - low_x)
    points = torch.stack([across, down], -1)
    found = lookup(cells, points.flatten(1, -2))
    return found.unflatten(1, places.shape[1:-1])


def at_times(layers: Tensor, places: Tensor, layer: Tensor, extent: Extent) -> Tensor:
    """Look up a stack of rasters at places, each in a layer of its own.

    layers: [B, K, H, W]; places: [B, ..., P, 2] m; layer: [P] from 0 to K - 1; returns [B, ..., P]
    """
    batch, count, height, width = layers.shape
    low_x, high_x, low_y, high_y = extent
    across = 1 - 2 * (places[..., 1] - low_y) / (high_y - low_y)
    row = (high_x - places[..., 0]) / (high_x - low_x) * height - 0.5
    # Laid below one another; a row that stays inside its layer mixes with no other.
    row = row.clamp(0, height - 1) + height * layer.to(row.dtype)
    down = (2 * row + 1) / (count * height) - 1
    points = torch.stack([across, down], -1).flatten(1, -2)
    found = lookup(layers.reshape(batch, count * height, width, 1), points)
    return found.reshape(across.shape)
