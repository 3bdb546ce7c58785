"""What the backbones share: flow time, modulation, and the map tokens' keys and values."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anchorflow_models.layers.embedding import GaussianFourierTime
from anchorflow_models.layers.map_attention import MapAttention
from anchorflow_models.layers.zero import zero_linear


class VectorField(nn.Module):
    """Fields of the position, its two derivatives by own time and the log duration at x_t.

    A backbone implements `forward(x_t, features, modulation, keys_values=None) -> [B, N, T, S]`
    with x_t [B, N, T, S], features [B, N, T, F] and modulation [B, 1 or N, M]. The condition
    reaches it through the modulation alone, which no sample changes.
    """

    def __init__(self, *, condition_width: int, neutral_modulation: Tensor) -> None:
        """neutral_modulation: [M], with which every block starts, whatever the condition."""
        super().__init__()
        self.time = GaussianFourierTime(condition_width)
        to_modulation = zero_linear(condition_width, len(neutral_modulation))
        with torch.no_grad():
            to_modulation.bias.copy_(neutral_modulation)
        self.to_modulation = nn.Sequential(nn.SiLU(), to_modulation)

    def modulate(self, condition: Tensor, t: Tensor) -> Tensor:
        """Every block's shifts, scales and gates.

        condition: [B, Q]; t: [K] or [B, K] -> [B, K, M]
        """
        time = self.time(t)
        return self.to_modulation(condition[:, None] + time)

    def keys_values(self, map_tokens: Tensor) -> Tensor:
        """Map tokens [B, P, Q] as every attending layer wants them, [B, L, 2, heads, P, E].

        They depend on the scene alone: computed once, and used at every evaluation.
        """
        layers = (module for module in self.modules() if isinstance(module, MapAttention))
        return torch.stack([layer.keys_values(map_tokens) for layer in layers], 1)


def repeat_last_step(x: Tensor, extra: int) -> Tensor:
    """[B, N, T, S] -> [B, N, T + extra, S]."""
    if extra == 0:
        return x
    return torch.cat([x, x[:, :, -1:].expand(-1, -1, extra, -1)], 2)
