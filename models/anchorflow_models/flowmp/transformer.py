"""The vector field: a transformer over the time steps of one trajectory."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.config import VARIANTS, TransformerSize
from anchorflow_models.layers.adaln import CHUNKS, AdaLNBlock, modulate, zero_linear
from anchorflow_models.layers.embedding import GaussianFourierTime, sinusoidal_positions


class FlowMPTransformer(nn.Module):
    """Fields u, v, w of position, velocity and acceleration at x_t [B, N, T, S].

    Each token covers `steps_per_token` time steps: their states and the map's features there, side
    by side, through one linear projection. Scene and flow time enter by AdaLN alone.
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
    ) -> None:
        super().__init__()
        self.state_dim, self.steps_per_token = state_dim, steps_per_token
        self.time = GaussianFourierTime(condition_width)
        self.to_modulation = nn.Sequential(
            nn.SiLU(), zero_linear(condition_width, (CHUNKS * size.layers + 2) * size.width)
        )
        self.project_in = nn.Linear(steps_per_token * (state_dim + feature_channels), size.width)
        tokens = num_steps // steps_per_token
        self.register_buffer("positions", sinusoidal_positions(tokens, size.width))
        self.blocks = nn.ModuleList(AdaLNBlock(size.width, size.heads) for _ in range(size.layers))
        self.norm = nn.LayerNorm(size.width, elementwise_affine=False)
        self.heads = zero_linear(size.width, steps_per_token * state_dim)
        self.chunks = [CHUNKS * size.width] * size.layers + [2 * size.width]

    def modulate(self, condition: Tensor, t: Tensor) -> Tensor:
        """Every block's shifts, scales and gates: condition [B, Q], t [K] or [B, K] -> [B, K, M]."""
        time = self.time(t)
        return self.to_modulation(condition[:, None] + time)

    def forward(self, x_t: Tensor, features: Tensor, modulation: Tensor) -> Tensor:
        """x_t: [B, N, T, S]; features: [B, N, T, F]; modulation: [B, 1 or N, M] -> [B, N, T, S]."""
        batch, count, steps, _ = x_t.shape
        tokens = steps // self.steps_per_token
        inputs = torch.cat([x_t, features], -1).reshape(batch, count, tokens, -1)
        x = self.project_in(inputs) + self.positions
        *per_block, last = modulation.unsqueeze(2).split(self.chunks, -1)
        for block, part in zip(self.blocks, per_block, strict=True):
            x = block(x, part)
        shift, scale = last.chunk(2, -1)
        fields = self.heads(modulate(self.norm(x), shift, scale))
        return fields.reshape(batch, count, steps, self.state_dim)


def create_flowmp_transformer(
    variant: str = "small",
    *,
    state_dim: int = 6,
    num_steps: int = 64,
    feature_channels: int = 21,
    condition_width: int = 256,
    steps_per_token: int = 8,
) -> FlowMPTransformer:
    """A transformer of a named size: "small", "base" or "large"; raises ValueError on another."""
    if variant not in VARIANTS:
        raise ValueError(f"variant: expected one of {sorted(VARIANTS)}, got {variant!r}")
    return FlowMPTransformer(
        VARIANTS[variant],
        state_dim=state_dim,
        num_steps=num_steps,
        feature_channels=feature_channels,
        condition_width=condition_width,
        steps_per_token=steps_per_token,
    )
