"""Residual 1-D convolutions with feature-wise linear modulation (FiLM; Perez et al., 2018)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

KERNEL = 3
GROUPS = 8


class FiLMBlock(nn.Module):
    """Two convolutions over time beside a shortcut; the condition scales and shifts in between.

    h = conv(silu(norm(x))); out = x + conv(silu(scale * norm(h) + shift))
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm_in = nn.GroupNorm(GROUPS, inputs)
        self.conv_in = nn.Conv1d(inputs, outputs, KERNEL, padding=KERNEL // 2)
        self.norm_out = nn.GroupNorm(GROUPS, outputs)
        self.conv_out = nn.Conv1d(outputs, outputs, KERNEL, padding=KERNEL // 2)
        self.shortcut = nn.Conv1d(inputs, outputs, 1) if inputs != outputs else nn.Identity()
        self.modulation_size = 2 * outputs

    def neutral_modulation(self) -> Tensor:
        """[2 C']: shifts of 0 and scales of 1."""
        return torch.cat(
            [torch.zeros(self.modulation_size // 2), torch.ones(self.modulation_size // 2)]
        )

    def forward(self, x: Tensor, modulation: Tensor) -> Tensor:
        """x: [B * N, C, T]; modulation: [B, 1 or N, 2 C'] -> [B * N, C', T]."""
        h = self.norm_out(self.conv_in(F.silu(self.norm_in(x))))
        by_scene = h.reshape(modulation.shape[0], -1, *h.shape[1:])
        shift, scale = modulation[..., None].chunk(2, -2)
        h = (by_scene * scale + shift).reshape(h.shape)
        return self.shortcut(x) + self.conv_out(F.silu(h))
