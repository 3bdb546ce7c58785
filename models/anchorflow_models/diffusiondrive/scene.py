"""What the denoiser and the scorers know of a scene."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, eq=False)
class SceneFeatures:
    """Worked out once a scene; of bev and values a graph of its own has what it reads, for both.

    bev: [B, W, H, H], of the square that the LiDAR sees, or with `ground_sight` of one before it
    values: [B, L, H, H, W], what each layer of the denoiser looks up in it
    agents: [B, Q, W], a query each
    ego: [B, 1, W]
    motion: [B, 4] the ego's velocity (m/s) and acceleration (m/s²), where the scorers are told it
    foretold: [B, FORETOLD_TIMES, H', H] the share of each cell that others take at these times,
        beyond the LiDAR's square too, where the scorers are told it
    """

    bev: Tensor
    values: Tensor
    agents: Tensor
    ego: Tensor
    motion: Tensor | None = None
    foretold: Tensor | None = None
