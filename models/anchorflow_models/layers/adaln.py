"""Transformer blocks modulated by a condition (AdaLN-Zero; Peebles & Xie, DiT, 2023)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.map_attention import MapAttention

CHUNKS = 6  # shift, scale and gate, for attention and for the feed-forward


def modulate(x: Tensor, shift: Tensor, scale: Tensor) -> Tensor:
    return x * scale + shift


def neutral_modulation(width: int, *, blocks: int) -> Tensor:
    """[M]: shifts of 0, scales of 1 and gates of 0 for the blocks, then a last shift and scale."""
    shift, scale, gate = torch.zeros(width), torch.ones(width), torch.zeros(width)
    return torch.cat([*[shift, scale, gate] * (2 * blocks), shift, scale])


class SelfAttention(nn.Module):
    """Multi-head self-attention over the tokens of one trajectory: [..., P, W] -> [..., P, W]."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_qkv = nn.Linear(width, 3 * width, bias=False)
        self.out = nn.Linear(width, width, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        *lead, tokens, width = x.shape
        qkv = self.to_qkv(x).reshape(-1, tokens, 3, self.heads, width // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4).unbind(0)
        # Written out: eight tokens need no flash attention, and its export is twice as many nodes.
        mixed = ((q * q.shape[-1] ** -0.5) @ k.transpose(-1, -2)).softmax(-1) @ v
        return self.out(mixed.transpose(1, 2).reshape(*lead, tokens, width))


class SquaredReLU(nn.Module):
    """max(x, 0)^2 (Primer; So et al., 2021): as good as GELU, at a quarter of its time on a CPU."""

    def forward(self, x: Tensor) -> Tensor:
        positive = F.relu(x)
        return positive * positive


class FeedForward(nn.Sequential):
    """Two layers, `ratio` times wider inside."""

    def __init__(self, width: int, ratio: int = 4) -> None:
        super().__init__(
            nn.Linear(width, ratio * width, bias=False),
            SquaredReLU(),
            nn.Linear(ratio * width, width, bias=False),
        )


class AdaLNBlock(nn.Module):
    """Attention and feed-forward, each normalised, shifted, scaled and gated by the condition.

    The modulation comes from outside: it depends on scene and time only, never on the sample. Its
    shifts make biases of the layers needless.
    With `map_attention` the tokens ask the map between the two.
    """

    def __init__(self, width: int, heads: int, *, map_attention: bool = False) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.attention = SelfAttention(width, heads)
        self.feed_forward = FeedForward(width)
        self.map_attention = MapAttention(width, heads) if map_attention else None

    def forward(self, x: Tensor, modulation: Tensor, keys_values: Tensor | None = None) -> Tensor:
        """x: [B, N, P, W]; modulation: [B, 1 or N, 1, 6 W]; keys_values: [B, 2, heads, P', E]."""
        shift_a, scale_a, gate_a, shift_f, scale_f, gate_f = modulation.chunk(CHUNKS, -1)
        x = x + gate_a * self.attention(modulate(self.norm(x), shift_a, scale_a))
        if self.map_attention is not None:
            assert keys_values is not None, "map attention needs the scene's keys and values"
            x = x + self.map_attention(x, keys_values)
        return x + gate_f * self.feed_forward(modulate(self.norm(x), shift_f, scale_f))
