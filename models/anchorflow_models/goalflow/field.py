"""The vector field of GoalFlow, from the trajectory that it expects at the end of the flow.

Both networks predict the controls of that trajectory, as differences from those of the way that it
began on. The kinematic model rolls them out, so that every answer can be driven, and the slope of
the straight path follows: u = (x_1 - x_t) / (1 - t).
"""

from __future__ import annotations

from torch import Tensor, nn

from anchorflow_models.goalflow.config import GoalFlowConfig
from anchorflow_models.layers.attention import AdaLNBlock, neutral_modulation
from anchorflow_models.layers.blocks import zero_linear
from anchorflow_models.layers.places import GaussianFourierTime, sinusoidal_positions

CONTROLS = 2  # acceleration, curvature
HEADS = 4


class MlpField(nn.Module):
    """A residual MLP over the whole trajectory."""

    def __init__(self, config: GoalFlowConfig, *, token: int, context: int) -> None:
        super().__init__()
        width, self.steps = config.width, config.num_steps
        self.time = GaussianFourierTime(width)
        self.of_scene = nn.Linear(context, width)
        self.first = nn.Linear(config.num_steps * token, width)
        self.hidden = nn.ModuleList(
            nn.Sequential(nn.SiLU(), nn.Linear(width, width)) for _ in range(config.layers)
        )
        self.out = zero_linear(width, CONTROLS * config.num_steps)

    def modulate(self, times: Tensor, context: Tensor) -> Tensor:
        """Times [B or 1, K] and context [B, E] -> [B, K, M]."""
        return self.time(times) + self.of_scene(context)[:, None]

    def forward(self, tokens: Tensor, modulation: Tensor) -> Tensor:
        """tokens [B, N, T, F], modulation [B, 1 or N, M] -> [B, N, T, 2]."""
        x = self.first(tokens.flatten(2)) + modulation
        for layer in self.hidden:
            x = x + layer(x)
        return self.out(x).unflatten(-1, (self.steps, CONTROLS))


class TransformerField(nn.Module):
    """AdaLN blocks over the trajectory's poses."""

    positions: Tensor

    def __init__(self, config: GoalFlowConfig, *, token: int, context: int) -> None:
        super().__init__()
        width = config.width
        self.time = GaussianFourierTime(width)
        self.of_scene = nn.Linear(context, width)
        neutral = neutral_modulation(width, blocks=config.layers)
        to_modulation = zero_linear(width, len(neutral))
        to_modulation.bias.data.copy_(neutral)
        self.to_modulation = nn.Sequential(nn.SiLU(), to_modulation)
        self.first = nn.Linear(token, width)
        self.register_buffer("positions", sinusoidal_positions(config.num_steps, width))
        self.blocks = nn.ModuleList(AdaLNBlock(width, HEADS) for _ in range(config.layers))
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.out = zero_linear(width, CONTROLS)

    def modulate(self, times: Tensor, context: Tensor) -> Tensor:
        """Times [B or 1, K] and context [B, E] -> [B, K, M]."""
        return self.to_modulation(self.time(times) + self.of_scene(context)[:, None])

    def forward(self, tokens: Tensor, modulation: Tensor) -> Tensor:
        """tokens [B, N, T, F], modulation [B, 1 or N, M] -> [B, N, T, 2]."""
        x, width = self.first(tokens) + self.positions, self.positions.shape[-1]
        parts = modulation[..., None, :].split(
            [6 * width] * len(self.blocks) + [width, width], dim=-1
        )
        for block, part in zip(self.blocks, parts[:-2], strict=True):
            x = block(x, part)
        return self.out(self.norm(x) * parts[-1] + parts[-2])


BACKBONES = {"mlp": MlpField, "transformer": TransformerField}
