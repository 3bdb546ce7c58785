"""The latent world model: what the BEV will be when the ego has driven an anchor."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anchorflow_models.layers.attention import EncoderLayer


class WorldModel(nn.Module):
    """The ego's token and the BEV's hear each other, `steps` times with the same layers.

    places: [1, 1 + M, W], learned, of the ego and of the BEV's M cells
    """

    def __init__(
        self, width: int, heads: int, *, hidden: int, layers: int, cells: int, steps: int
    ) -> None:
        super().__init__()
        self.steps = steps
        self.places = nn.Parameter(0.02 * torch.randn(1, 1 + cells, width))
        self.layers = nn.Sequential(
            *[EncoderLayer(width, heads, hidden=hidden) for _ in range(layers)]
        )

    def forward(
        self, ego: Tensor, bev: Tensor, *, here: Tensor, there: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Ego and BEV in the future of every anchor.

        ego: [B, K, W]; bev: [B, M, W]
        here: [M] one-hot, the ego's cell now; there: [B or 1, K, steps, M], its cells to come
        Returns ego [B, K, W] and BEV [B, K, M, W], the ego added where it will be.
        """
        batch, count, width = ego.shape
        bev = inject(bev[:, None], here, ego)
        for step in range(self.steps):
            # Without layers the present goes on.
            if len(self.layers):
                tokens = torch.cat([ego[:, :, None], bev], 2)
                tokens = tokens.reshape(batch * count, -1, width) + self.places
                tokens = self.layers(tokens).reshape(batch, count, -1, width)
                ego, bev = tokens[:, :, 0], tokens[:, :, 1:]
            bev = inject(bev, there[:, :, step], ego)
        return ego, bev


def inject(bev: Tensor, cell: Tensor, ego: Tensor) -> Tensor:
    """The BEV [B, 1 or K, M, W] with the ego [B, K, W] added in its cell, one-hot [..., M].

    A product with zeros and a one rather than a scatter: it exports, and no index of one scene can
    reach another.
    """
    return bev + cell[..., None] * ego[:, :, None]
