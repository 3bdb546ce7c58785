"""Scenes for the networks, and networks whose every branch is open."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from anchorflow_models import L2Config, L2SafetyCFM, create_l2_safety_cfm
from anchorflow_trajectory.spline.basis import Ends

SIZE, EXTENT = 40, 8.0  # cells and m a side of the scenes' maps

Scene = dict[str, Tensor]


@pytest.fixture(scope="session")
def make_scene() -> Callable[..., Scene]:
    """Makes two scenes that differ, of any D and C; always the same. The second has a horizon."""

    def make(dim: int = 2, *, channels: int = 3) -> Scene:
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

    return make


@pytest.fixture(scope="session")
def open_branches() -> Callable[[nn.Module], None]:
    """Fills what starts at zero: it would hide everything behind it."""

    def fill(module: nn.Module) -> None:
        for parameter in module.parameters():
            if not parameter.any():
                nn.init.normal_(parameter, std=0.05)

    return fill


@pytest.fixture(scope="session")
def make_model(open_branches: Callable[[nn.Module], None]) -> Callable[..., L2SafetyCFM]:
    """Makes a planner with the options given, always of the same weights, every branch open."""

    def make(**options: Any) -> L2SafetyCFM:
        with torch.random.fork_rng():
            torch.manual_seed(0)
            model = create_l2_safety_cfm(L2Config(**options))
            open_branches(model)
        return model.eval()

    return make


@pytest.fixture(scope="session")
def means_of() -> Callable[..., Tensor]:
    """Makes prior means [B, N, T, S]: N splines between a scene's ends, no two alike.

    They last from 3 s, or as long as its horizon, and bow to both sides.
    """

    def means(model: L2SafetyCFM, scene: Scene, count: int) -> Tensor:
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

    return means


@pytest.fixture(scope="session")
def field_of(means_of: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """The field at x_0 drawn from noise [1, N, R], all samples at flow time 0.3.

    mean: [B, N, T, S] around which it is drawn; by default that of `means_of`
    """

    @torch.no_grad()
    def field(
        model: L2SafetyCFM, scene: Scene, noise: Tensor, mean: Tensor | None = None
    ) -> Tensor:
        context = model.encode(**scene)
        modulation = model.modulate(torch.tensor([0.3]), context)[:, 0]
        mean = means_of(model, scene, noise.shape[1]) if mean is None else mean
        return model.field(model.draw(noise, mean, context), mean, modulation, context)

    return field
