"""The vector field: a transformer over the time steps of one trajectory."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.config import (
    VARIANTS,
    TransformerSize,
    check_choice,
    transformer_size,
)
from anchorflow_models.layers.attention import (
    CHUNKS,
    AdaLNBlock,
    MapAttention,
    modulate,
    neutral_modulation,
)
from anchorflow_models.layers.blocks import zero_linear
from anchorflow_models.layers.places import GaussianFourierTime, sinusoidal_positions


class VectorField(nn.Module):
    """Fields of the position, its two derivatives by own time and the log duration at x_t.

    A backbone implements `forward(x_t, features, modulation, keys_values=None) -> [B, N, T, S]`
    with x_t [B, N, T, S], features [B, N, T, F] and modulation [B, 1 or N, M]. The condition
    reaches it through the modulation alone, which no sample changes.
    """

    def __init__(
        self,
        *,
        condition_width: int,
        neutral_modulation: Tensor,
        fourier_features: int = 64,
        fourier_scale: float = 2.0,
    ) -> None:
        """neutral_modulation: [M], with which every block starts, whatever the condition."""
        super().__init__()
        self.time = GaussianFourierTime(
            condition_width, features=fourier_features, scale=fourier_scale
        )
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


class FlowMPTransformer(VectorField):
    """Fields at x_t [B, N, T, S]; scene and flow time enter by AdaLN alone.

    Each token covers `steps_per_token` time steps: their states and the map's features there, side
    by side, through one linear projection. The last step is repeated where T is no multiple.
    """

    positions: Tensor

    def __init__(
        self,
        size: TransformerSize,
        *,
        state_dim: int,
        num_steps: int,
        feature_channels: int,
        condition_width: int,
        steps_per_token: int = 8,
        map_attention: bool = False,
        activation: str = "squared_relu",
        **time: Any,
    ) -> None:
        super().__init__(
            condition_width=condition_width,
            neutral_modulation=neutral_modulation(size.width, blocks=size.layers),
            **time,
        )
        self.num_steps, self.extra_steps = num_steps, -num_steps % steps_per_token
        self.steps_per_token = steps_per_token
        self.project_in = nn.Linear(steps_per_token * (state_dim + feature_channels), size.width)
        self.tokens = (num_steps + self.extra_steps) // steps_per_token
        self.register_buffer("positions", sinusoidal_positions(self.tokens, size.width))
        self.blocks = nn.ModuleList(
            AdaLNBlock(size.width, size.heads, map_attention=map_attention, activation=activation)
            for _ in range(size.layers)
        )
        self.norm = nn.LayerNorm(size.width, elementwise_affine=False)
        self.heads = zero_linear(size.width, steps_per_token * state_dim)
        self.chunks = [CHUNKS * size.width] * size.layers + [2 * size.width]

    def forward(
        self,
        x_t: Tensor,
        features: Tensor,
        modulation: Tensor,
        keys_values: Tensor | None = None,
    ) -> Tensor:
        """x_t: [B, N, T, S]; features: [B, N, T, F]; modulation: [B, 1 or N, M] -> [B, N, T, S]."""
        inputs = repeat_last_step(torch.cat([x_t, features], -1), self.extra_steps)
        x = self.project_in(inputs.unflatten(2, (self.tokens, -1)).flatten(3)) + self.positions
        *per_block, last = modulation.unsqueeze(2).split(self.chunks, -1)
        answers = keys_values.unbind(1) if keys_values is not None else [None] * len(self.blocks)
        for block, part, answer in zip(self.blocks, per_block, answers, strict=True):
            x = block(x, part, answer)
        shift, scale = last.chunk(2, -1)
        fields = self.heads(modulate(self.norm(x), shift, scale))
        by_step = fields.unflatten(-1, (self.steps_per_token, -1)).flatten(2, 3)
        return by_step[:, :, : self.num_steps]


def create_flowmp_transformer(
    variant: str = "small",
    *,
    state_dim: int = 7,
    num_steps: int = 64,
    feature_channels: int = 32,
    condition_width: int = 256,
    layers: int = 0,
    width: int = 0,
    heads: int = 0,
    **options: Any,
) -> FlowMPTransformer:
    """A transformer of a named size: "small", "base" or "large"; raises ValueError on another.

    layers, width, heads: 0: as that size has; options: `FlowMPTransformer`'s others
    """
    check_choice("variant", variant, tuple(VARIANTS))
    return FlowMPTransformer(
        transformer_size(variant, layers=layers, width=width, heads=heads),
        state_dim=state_dim,
        num_steps=num_steps,
        feature_channels=feature_channels,
        condition_width=condition_width,
        **options,
    )
