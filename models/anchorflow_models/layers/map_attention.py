"""Cross-attention from a trajectory to the map."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.zero import zero_linear

MAP_TOKEN_WIDTH = 128


class MapAttention(nn.Module):
    """Trajectory tokens ask, map tokens answer (Vaswani et al., 2017); starts at zero.

    The keys and values come from outside, `keys_values` computes them once a scene. No map token
    belongs to one sample, so the tokens of all samples are the queries of one product.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.to_query = nn.Linear(width, width)
        self.to_keys_values = nn.Linear(MAP_TOKEN_WIDTH, 2 * width)
        self.out = zero_linear(width, width)

    def keys_values(self, map_tokens: Tensor) -> Tensor:
        """[B, P, Q] -> [B, 2, heads, P, width / heads]."""
        split = self.to_keys_values(map_tokens).unflatten(-1, (2, self.heads, -1))
        return split.permute(0, 2, 3, 1, 4)

    def forward(self, x: Tensor, keys_values: Tensor) -> Tensor:
        """What to add to x [B, N, P', width]."""
        batch, count, tokens, width = x.shape
        query = self.to_query(self.norm(x))
        query = query.reshape(batch, count * tokens, self.heads, width // self.heads)
        keys, values = keys_values.unbind(1)
        mixed = F.scaled_dot_product_attention(query.transpose(1, 2), keys, values)
        return self.out(mixed.transpose(1, 2).reshape(batch, count, tokens, width))
