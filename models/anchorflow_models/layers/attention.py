"""Multi-head attention and the transformer layers made of it (Vaswani et al., 2017)."""

from __future__ import annotations

from torch import Tensor, nn


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
