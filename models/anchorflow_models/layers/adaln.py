"""Transformer blocks modulated by a condition (AdaLN-Zero; Peebles & Xie, DiT, 2023)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

CHUNKS = 6  # shift, scale and gate, for attention and for the feed-forward


def modulate(x: Tensor, shift: Tensor, scale: Tensor) -> Tensor:
    return x * (1 + scale) + shift


class SelfAttention(nn.Module):
    """Multi-head self-attention over the tokens of one trajectory: [..., P, W] -> [..., P, W]."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        *lead, tokens, width = x.shape
        qkv = self.to_qkv(x).reshape(-1, tokens, 3, self.heads, width // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4).unbind(0)
        mixed = F.scaled_dot_product_attention(q, k, v)
        return self.out(mixed.transpose(1, 2).reshape(*lead, tokens, width))


class FeedForward(nn.Sequential):
    """Two layers, `ratio` times wider inside."""

    def __init__(self, width: int, ratio: int = 4) -> None:
        super().__init__(nn.Linear(width, ratio * width), nn.GELU(), nn.Linear(ratio * width, width))


class AdaLNBlock(nn.Module):
    """Attention and feed-forward, each normalised, shifted, scaled and gated by the condition.

    The modulation comes from outside: it depends on scene and time only, never on the sample.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.attention = SelfAttention(width, heads)
        self.feed_forward = FeedForward(width)

    def forward(self, x: Tensor, modulation: Tensor) -> Tensor:
        """x: [B, N, P, W]; modulation: [B, 1 or N, 1, 6 W]."""
        shift_a, scale_a, gate_a, shift_f, scale_f, gate_f = modulation.chunk(CHUNKS, -1)
        x = x + gate_a * self.attention(modulate(self.norm(x), shift_a, scale_a))
        return x + gate_f * self.feed_forward(modulate(self.norm(x), shift_f, scale_f))


def zero_linear(inputs: int, outputs: int) -> nn.Linear:
    """A linear layer that starts at zero, so that its branch starts as the identity."""
    layer = nn.Linear(inputs, outputs)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


