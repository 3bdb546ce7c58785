"""Scenes for the networks, and networks whose every branch is open."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from anchorflow_models import L2Config, L2SafetyCFM, create_l2_safety_cfm

SIZE, EXTENT = 40, 8.0  # cells and m a side of the scenes' maps

Scene = dict[str, Tensor]


@pytest.fixture(scope="session")
def make_scene() -> Callable[..., Scene]:
    """Makes two scenes that differ, of any D and C; always the same."""

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
            "cost_to_go": 5 * rand(2, SIZE, SIZE),
            "x_curr": torch.cat([ends[:, :2], headings[0], rand(2 * dim)], -1),
            "x_goal": torch.cat([ends[:, 2:], headings[1], rand(dim)], -1),
            "w_style": torch.tensor([[0.4, 0.3, 0.3], [0.1, 0.8, 0.1]]),
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
def field_of() -> Callable[..., Tensor]:
    """The field at x_0 drawn from noise [1, N, R], all samples at flow time 0.3."""

    @torch.no_grad()
    def field(model: L2SafetyCFM, scene: Scene, noise: Tensor) -> Tensor:
        context = model.encode(**scene)
        modulation = model.modulate(torch.tensor([0.3]), context)[:, 0]
        return model.field(model.draw(noise, context), modulation, context)

    return field
