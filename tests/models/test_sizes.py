"""docs/models.md lists the true sizes of the networks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from flowmp_scenes import make_scene
from torch import Tensor, nn
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.utils.flop_counter import FlopCounterMode

from anchorflow_models import (
    L2Config,
    L2SafetyCFM,
    create_flowmp_transformer,
    create_flowmp_unet1d,
    create_l2_safety_cfm,
)

PAGE = Path(__file__).resolve().parents[2] / "docs" / "models.md"
VARIANTS = ("small", "base", "large")

# (backbone, variant): parameters of the backbone and of the planner, MFLOP an evaluation
SIZES = {
    ("transformer", "small"): (1_787_832, 2_576_056, 13),
    ("transformer", "base"): (7_412_024, 8_200_248, 77),
    ("transformer", "large"): (32_032_824, 32_821_048, 407),
    ("unet", "small"): (2_386_567, 3_174_791, 40),
    ("unet", "base"): (7_979_783, 8_768_007, 158),
    ("unet", "large"): (29_082_631, 29_870_855, 633),
}
OPTIONS = [
    ({"map_attention": True}, 2_871_352, 17),
    ({"map_attention": True, "map_lookup": False}, 2_721_512, 17),
    ({"map_lookup": False}, 2_442_600, 13),
    ({"map_scales": 2}, 3_315_640, 14),
    ({"layers": 2}, 1_788_088, 7),
    ({"steps_per_token": 4}, 2_552_476, 26),
    ({"steps_per_token": 2}, 2_540_686, 53),
    ({"steps_per_token": 1}, 2_534_791, 110),
    ({"dim": 3}, 2_582_992, 14),
]


def size(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


@torch.no_grad()
def megaflops(model: L2SafetyCFM, scene: dict[str, Tensor]) -> tuple[int, int]:
    """MFLOP of `encode` for a scene and of `field` for a trajectory, rounded."""
    one = {name: value[:1] for name, value in scene.items()}
    # Only the plain kernel's products are counted on every machine.
    with sdpa_kernel(SDPBackend.MATH), FlopCounterMode(display=False) as encode:
        context = model.encode(**one)
    modulation = model.modulate(torch.tensor([0.5]), context)[:, 0]
    mean = torch.zeros(1, 4, model.config.num_steps, model.config.state_dim)
    x_t = model.draw(torch.randn(1, 4, model.prior.rank), mean, context)
    with sdpa_kernel(SDPBackend.MATH), FlopCounterMode(display=False) as field:
        model.field(x_t, mean, modulation, context)
    return round(encode.get_total_flops() / 1e6), round(field.get_total_flops() / 4e6)


@pytest.mark.parametrize(("backbone", "variant"), SIZES)
def test_variants(backbone: str, variant: str) -> None:
    alone, planner, cost = SIZES[backbone, variant]
    model = create_l2_safety_cfm(L2Config(backbone=backbone, variant=variant))
    assert size(model.vector_field) == alone
    assert size(model) == planner
    assert megaflops(model, make_scene()) == (336, cost)
    rows = [line for line in PAGE.read_text().splitlines() if f"| {backbone} | {variant} |" in line]
    assert [row.split(" | ", 3)[3] for row in rows] == [f"{alone:,} | {planner:,} | {cost} |"]


@pytest.mark.parametrize(("options", "planner", "cost"), OPTIONS)
def test_options(options: dict[str, Any], planner: int, cost: int) -> None:
    model = create_l2_safety_cfm(L2Config(**options))
    assert size(model) == planner
    assert megaflops(model, make_scene(model.config.dim))[1] == cost
    words = ", ".join(f"{name}={value}" for name, value in options.items())
    assert f"| `{words}` | {planner:,} | {cost} |" in PAGE.read_text()


def test_the_backbones_alone_have_the_planner_s_sizes() -> None:
    assert size(create_flowmp_transformer()) == SIZES["transformer", "small"][0]
    assert size(create_flowmp_unet1d()) == SIZES["unet", "small"][0]
    blocks = [size(create_flowmp_transformer(variant).blocks) for variant in VARIANTS]
    assert blocks == [786_432, 4_718_592, 25_165_824]
