"""Multi-head attention and the transformer layers made of it (Vaswani et al., 2017)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.blocks import zero_linear


class Attention(nn.Module):
    """Queries [B, P, W] ask a context [B, Q, W], which is the queries themselves by default."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_query = nn.Linear(width, width)
        self.to_keys_values = nn.Linear(width, 2 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor, context: Tensor | None = None) -> Tensor:
        context = x if context is None else context
        q = self.to_query(x).unflatten(-1, (self.heads, -1)).transpose(1, 2)
        pairs = self.to_keys_values(context).unflatten(-1, (2, self.heads, -1))
        k, v = pairs.permute(2, 0, 3, 1, 4).unbind(0)
        # Written out: few tokens need no flash attention, and its export is twice as many nodes.
        mixed = ((q * q.shape[-1] ** -0.5) @ k.transpose(-1, -2)).softmax(-1) @ v
        return self.out(mixed.transpose(1, 2).flatten(2))


class FeedForward(nn.Sequential):
    """Two layers, `hidden` wide inside."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__(nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, width))


class PreNormLayer(nn.Module):
    """Self-attention and feed-forward, each of what was normalised before it (as in GPT-2)."""

    def __init__(self, width: int, heads: int, *, hidden: int) -> None:
        super().__init__()
        self.norm_attention, self.norm_feed_forward = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attention = Attention(width, heads)
        self.feed_forward = FeedForward(width, hidden)

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, P, W] -> the same"""
        x = x + self.attention(self.norm_attention(x))
        return x + self.feed_forward(self.norm_feed_forward(x))


class EncoderLayer(nn.Module):
    """Self-attention and feed-forward, each sum normalised."""

    def __init__(self, width: int, heads: int, *, hidden: int) -> None:
        super().__init__()
        self.attention = Attention(width, heads)
        self.feed_forward = FeedForward(width, hidden)
        self.norm_attention, self.norm_feed_forward = nn.LayerNorm(width), nn.LayerNorm(width)

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, P, W] -> the same"""
        x = self.norm_attention(x + self.attention(x))
        return self.norm_feed_forward(x + self.feed_forward(x))


class DecoderLayer(nn.Module):
    """Self-attention, attention to a context and feed-forward, each sum normalised."""

    def __init__(self, width: int, heads: int, *, hidden: int) -> None:
        super().__init__()
        self.attention, self.to_context = Attention(width, heads), Attention(width, heads)
        self.feed_forward = FeedForward(width, hidden)
        self.norm_attention, self.norm_context = nn.LayerNorm(width), nn.LayerNorm(width)
        self.norm_feed_forward = nn.LayerNorm(width)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """x: [B, P, W]; context: [B, Q, W] -> [B, P, W]"""
        x = self.norm_attention(x + self.attention(x))
        x = self.norm_context(x + self.to_context(x, context))
        return self.norm_feed_forward(x + self.feed_forward(x))


class Decoder(nn.Module):
    """Decoder layers one after another."""

    def __init__(self, width: int, heads: int, *, hidden: int, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            DecoderLayer(width, heads, hidden=hidden) for _ in range(layers)
        )

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """x: [B, P, W]; context: [B, Q, W] -> [B, P, W]"""
        for layer in self.layers:
            x = layer(x, context)
        return x


MAP_TOKEN_WIDTH = 128


class MapAttention(nn.Module):
    """Trajectory tokens ask, map tokens answer (Vaswani et al., 2017); starts at zero.

    The keys and values are inputs; `keys_values` computes them once a scene. No map token
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


ACTIVATIONS = {
    "squared_relu": SquaredReLU,
    "relu": nn.ReLU,
    "gelu": nn.GELU,
    "silu": nn.SiLU,
}


class AdaLNFeedForward(nn.Sequential):
    """Two layers, `ratio` times wider inside."""

    def __init__(self, width: int, activation: str, ratio: int = 4) -> None:
        super().__init__(
            nn.Linear(width, ratio * width, bias=False),
            ACTIVATIONS[activation](),
            nn.Linear(ratio * width, width, bias=False),
        )


class AdaLNBlock(nn.Module):
    """Attention and feed-forward, each normalised, shifted, scaled and gated by the condition.

    The modulation is an input: it depends on scene and time only, never on the sample. Its shifts
        replace the layers' biases.
    With `map_attention` the tokens ask the map between the two.
    """

    def __init__(
        self,
        width: int,
        heads: int,
        *,
        map_attention: bool = False,
        activation: str = "squared_relu",
    ) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.attention = SelfAttention(width, heads)
        self.feed_forward = AdaLNFeedForward(width, activation)
        self.map_attention = MapAttention(width, heads) if map_attention else None

    def forward(self, x: Tensor, modulation: Tensor, keys_values: Tensor | None = None) -> Tensor:
        """x: [B, N, P, W]; modulation: [B, 1 or N, 1, 6 W]; keys_values: [B, 2, heads, P', E]."""
        shift_a, scale_a, gate_a, shift_f, scale_f, gate_f = modulation.chunk(CHUNKS, -1)
        x = x + gate_a * self.attention(modulate(self.norm(x), shift_a, scale_a))
        if self.map_attention is not None:
            assert keys_values is not None, "map attention needs the scene's keys and values"
            x = x + self.map_attention(x, keys_values)
        return x + gate_f * self.feed_forward(modulate(self.norm(x), shift_f, scale_f))
