"""Warm starts: a previous plan in place of most of the noise."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.generation.checks import batched, check
from anchorflow_trajectory.resample import resampled_states, whole_fields


@dataclass(frozen=True, eq=False)
class WarmStart:
    """trajectory: [T', D], [T', 2D] or [T', 3D] over the model's horizon: positions, then
        velocities, then accelerations; [B, T', ...] for several scenes
    tau: flow time in (0, 1) to start from; near 1 the anchors stay near the plan
    """

    trajectory: ArrayLike | Tensor
    tau: float = 0.8

    def __post_init__(self) -> None:
        check("warm_start.tau", 0 < self.tau < 1, "a flow time in (0, 1)", self.tau)

    def noised(self, x_0: Tensor, config: L2Config) -> Tensor:
        """x_tau = tau x_1 + (1 - tau) x_0 [B, N, T, S], where x_1 is the plan."""
        name, dim = "warm_start.trajectory", config.dim
        plan = batched(name, self.trajectory, f"[T', {dim} to {3 * dim}]", (None, None))
        scenes, steps, columns = plan.shape
        check(name, whole_fields(columns, dim), f"columns of {dim} a field", columns)
        check(name, steps >= 2, "2 time steps or more", steps)
        check(name, scenes in (1, len(x_0)), f"B of 1 or {len(x_0)}", scenes)
        states = resampled_states(
            plan, dim=dim, num_steps=config.num_steps, horizon_s=config.horizon_s
        )
        x_1 = torch.from_numpy(states).to(x_0)[:, None]
        return self.tau * x_1 + (1 - self.tau) * x_0
