"""FlowMP in tests: scenes, networks whose every branch is open, and a flow in closed form."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from anchorflow_models import L2Config, L2SafetyCFM, create_l2_safety_cfm
from anchorflow_models.flowmp.frame import Frame
from anchorflow_models.flowmp.prior import TrajectoryPrior
from anchorflow_trajectory.spline.basis import Ends

SIZE, EXTENT = 40, 8.0  # cells and m a side of the scenes' maps

Scene = dict[str, Tensor]


def make_scene(dim: int = 2, *, channels: int = 3) -> Scene:
    """Return two scenes that differ, of any D and C; always the same. The second has a horizon."""
    generator = torch.Generator().manual_seed(1)

    def rand(*shape: int) -> Tensor:
        return torch.rand(2, *shape, generator=generator)

    ends = torch.tensor([[-3.0, -2.0, 2.5, 3.0], [-2.0, 1.0, 3.0, -3.0]])
    headings = [rand(dim - 2) for _ in range(2)]
    return {
        "cost_map": rand(channels, SIZE, SIZE),
        "map_geometry": torch.tensor([[-4.0, -4.0, EXTENT / SIZE]]).repeat(2, 1),
        "clearance_field": rand(SIZE, SIZE),
        "x_curr": torch.cat([ends[:, :2], headings[0], rand(2 * dim)], -1),
        "x_goal": torch.cat([ends[:, 2:], headings[1], rand(dim)], -1),
        "w_style": torch.tensor([[0.4, 0.3, 0.3], [0.1, 0.8, 0.1]]),
        "limits": torch.tensor([[2.0, 3.0, 0.25, 0.0], [0.8, 1.5, 0.4, 5.0]]),
    }


def open_branches(module: nn.Module, *, std: float = 0.05) -> None:
    """Fill what starts at zero: it would hide everything behind it."""
    for parameter in module.parameters():
        if not parameter.any():
            nn.init.normal_(parameter, std=std)


def make_model(**options: Any) -> L2SafetyCFM:
    """Return a planner with the options given, always of the same weights, every branch open."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = create_l2_safety_cfm(L2Config(**options))
        open_branches(model)
    return model.eval()


def means_of(model: L2SafetyCFM, scene: Scene, count: int) -> Tensor:
    """Return prior means [B, N, T, S]: N splines between a scene's ends, no two alike.

    They last from 3 s, or as long as its horizon, and bow to both sides.
    """
    basis, dim = model.config.basis, model.config.dim
    bulge = np.sin(np.linspace(0.0, np.pi, basis.num_control_points))[basis.free]
    every = []
    for x_curr, x_goal, limits in zip(
        *(scene[name].numpy() for name in ("x_curr", "x_goal", "limits")), strict=True
    ):
        duration = np.full(count, limits[3]) if limits[3] else 3.0 + 0.5 * np.arange(count)
        splines = basis.rest_curves(Ends(x_curr, x_goal), duration)
        splines.control[1, :, basis.free] += np.outer(np.arange(count) - 1.0, bulge)
        states = basis.own_time_states(splines.control)
        lasting = np.broadcast_to(np.log(duration)[:, None, None], (*states.shape[:2], 1))
        every.append(np.concatenate([states, lasting], -1))
    assert every[0].shape[-1] == 3 * dim + 1
    return torch.from_numpy(np.stack(every)).float()


@torch.no_grad()
def field_of(model: L2SafetyCFM, scene: Scene, noise: Tensor, mean: Tensor | None = None) -> Tensor:
    """Return the field at x_0 drawn from noise [1, N, R], all samples at flow time 0.3.

    mean: [B, N, T, S] around which it is drawn; by default that of `means_of`
    """
    context = model.encode(**scene)
    modulation = model.modulate(torch.tensor([0.3]), context)[:, 0]
    mean = means_of(model, scene, noise.shape[1]) if mean is None else mean
    return model.field(model.draw(noise, mean, context), mean, modulation, context)


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

    def encode(self, *_: Tensor, **scene: Tensor) -> dict[str, Tensor]:
        ends = (scene[name][:, : self.config.dim] for name in ("x_curr", "x_goal"))
        return {"prior_basis": self.prior.basis(Frame.between(*ends), scene["limits"][:, 3])}

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


ROOM, FREE_ROOM = Room(), Room(block=False)
PLAIN: dict[str, Any] = {"smooth": False, "project": False}
"""Settings that leave anchors as the flow drew them."""
