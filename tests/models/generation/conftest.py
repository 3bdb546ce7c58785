"""A planner whose flow is known in closed form, and a scene to plan in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from anchorflow_models import L2Config
from anchorflow_models.flowmp.frame import Frame
from anchorflow_models.flowmp.prior import TrajectoryPrior

CELLS, RESOLUTION = 80, 0.1
START, GOAL = (-3.0, 0.05), (3.0, 0.05)

SMALL = L2Config(num_steps=32, num_control_points=12)


@dataclass(eq=False)
class GaussianFlow:
    """The exact flow between two mixtures of Gaussians of one covariance Σ_0, the prior's:

        x_1 ~ N(m_r + shift, Σ_0)    u = shift + (2 t - 1) / r^2 (x_t - m_r - t shift)
        x_t = m_r + t shift + r (x_0 - m_r)                          r^2 = t^2 + (1 - t)^2

    where m_r is the route that a sample begins on.

    shift: [S], added at every time step
    asked: the flow times of each call of `modulate`
    """

    config: L2Config = SMALL
    shift: Tensor = field(default_factory=lambda: torch.zeros(7))
    asked: list[list[float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.prior = TrajectoryPrior(self.config)

    def encode(
        self, x_curr: Tensor, x_goal: Tensor, limits: Tensor, **_: Tensor
    ) -> dict[str, Tensor]:
        frame = Frame.between(x_curr[:, : self.config.dim], x_goal[:, : self.config.dim])
        return {"prior_basis": self.prior.basis(frame, limits[:, 3])}

    def modulate(self, times: Tensor, context: dict[str, Tensor]) -> Tensor:
        self.asked.append(times.tolist())
        return times[None, :, None].expand(len(context["prior_basis"]), -1, 1)

    def field(
        self, x_t: Tensor, prior_mean: Tensor, modulation: Tensor, context: dict[str, Tensor]
    ) -> Tensor:
        assert "prior_basis" in context
        t = modulation[:, None, None]
        middle = prior_mean + t * self.shift
        return self.shift + (2 * t - 1) / (t**2 + (1 - t) ** 2) * (x_t - middle)

    def draw(self, noise: Tensor, prior_mean: Tensor, context: dict[str, Tensor]) -> Tensor:
        return prior_mean + (noise @ context["prior_basis"]).unflatten(-1, prior_mean.shape[2:])


@pytest.fixture
def gaussian_flow() -> Callable[..., GaussianFlow]:
    return GaussianFlow


@dataclass(frozen=True)
class Room:
    """A scene of 8 x 8 m round (0, 0) with a block of 1.2 x 1.2 m between start and goal."""

    block: bool = True
    x_curr: tuple[float, ...] = (*START, 0.3, 0.0, 0.0, 0.0)
    x_goal: tuple[float, ...] = (*GOAL, 0.0, 0.0)

    @property
    def cost_map(self) -> np.ndarray:
        cost_map = np.zeros((1, CELLS, CELLS), np.float32)
        if self.block:
            cost_map[0, 34:46, 34:46] = 1.0
        return cost_map

    @property
    def ends(self) -> tuple[np.ndarray, tuple[float, ...], tuple[float, ...]]:
        """cost_map, x_curr, x_goal: what `generate` wants first."""
        return self.cost_map, self.x_curr, self.x_goal


@pytest.fixture
def room() -> Room:
    return Room()


@pytest.fixture
def free_room() -> Room:
    return Room(block=False)


@pytest.fixture
def plain() -> dict[str, Any]:
    """Settings that leave anchors as the flow drew them."""
    return {"smooth": False, "project": False}
