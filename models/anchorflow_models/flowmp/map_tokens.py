"""The map as tokens that a trajectory can attend to."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from anchorflow_models.layers.embedding import fourier_places
from anchorflow_models.layers.map_attention import MAP_TOKEN_WIDTH


class MapTokens(nn.Module):
    """One token a cell of the encoder's coarse grid: what is there, and where that is.

    widths: of the windows, in units of the nearest one's; each has a projection of its own
    cells: a side of the coarse grid, the same for every window
    """

    places: Tensor  # [windows, cells^2, 4 octaves]

    def __init__(self, coarse_channels: int, *, cells: int, widths: Sequence[float]) -> None:
        super().__init__()
        line = (torch.arange(cells) + 0.5) * (2.0 / cells) - 1.0
        y, x = torch.meshgrid(line, line, indexing="ij")
        centres = torch.stack([x, y], -1).reshape(-1, 2)
        places = torch.stack([fourier_places(width * centres) for width in widths])
        self.register_buffer("places", places)
        self.projections = nn.ModuleList(
            nn.Linear(coarse_channels + places.shape[-1], MAP_TOKEN_WIDTH) for _ in widths
        )
        self.norm = nn.LayerNorm(MAP_TOKEN_WIDTH)

    def forward(self, coarse: Sequence[Tensor]) -> Tensor:
        """Coarse features [B, E, cells, cells] of each window -> [B, windows * cells^2, Q]."""
        tokens = []
        for grid, places, project in zip(coarse, self.places, self.projections, strict=True):
            cells = grid.flatten(2).transpose(1, 2)
            where = places.expand(cells.shape[0], -1, -1)
            tokens.append(project(torch.cat([cells, where], -1)))
        return self.norm(torch.cat(tokens, 1))
