"""The two vector fields: steps that nothing divides, what reaches what."""

from __future__ import annotations

import pytest
import torch
from flowmp_scenes import open_branches
from torch import Tensor

from anchorflow_models import (
    FlowMPTransformer,
    FlowMPUNet1D,
    create_flowmp_transformer,
    create_flowmp_unet1d,
)

Backbone = FlowMPTransformer | FlowMPUNet1D
CREATE = {"transformer": create_flowmp_transformer, "unet": create_flowmp_unet1d}


def make_backbone(kind: str, num_steps: int = 45, **options: int) -> Backbone:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        backbone = CREATE[kind](num_steps=num_steps, feature_channels=3, **options)
        open_branches(backbone)
    return backbone.eval()


@torch.no_grad()
def fields(backbone: Backbone, x_t: Tensor, features: Tensor) -> Tensor:
    generator = torch.Generator().manual_seed(3)
    condition = torch.randn(x_t.shape[0], 256, generator=generator)
    return backbone(x_t, features, backbone.modulate(condition, torch.tensor([0.4])))


def inputs(steps: int = 45) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(2)
    shape = (2, 3, steps)
    return torch.randn(*shape, 7, generator=generator), torch.randn(*shape, 3, generator=generator)


@pytest.mark.parametrize("kind", CREATE)
def test_the_last_step_is_repeated_inside(kind: str) -> None:
    short, whole = make_backbone(kind, 45), make_backbone(kind, 48)
    weights = {k: v for k, v in short.state_dict().items() if k != "positions"}
    whole.load_state_dict(weights, strict=False)
    if kind == "unet":  # it repeats its inputs together with their positions
        whole.positions[45:] = whole.positions[44]
    x_t, features = inputs()
    padded = [torch.cat([x, x[:, :, -1:].repeat(1, 1, 3, 1)], 2) for x in (x_t, features)]
    expected = fields(whole, *padded)[:, :, :45]
    torch.testing.assert_close(fields(short, x_t, features), expected)


@pytest.mark.parametrize("kind", CREATE)
def test_first_and_last_step_hear_each_other(kind: str) -> None:
    backbone, (x_t, features) = make_backbone(kind), inputs()
    base = fields(backbone, x_t, features)
    for changed, heard in ((0, -1), (-1, 0)):
        other = x_t.clone()
        other[:, :, changed] += 1.0
        assert not torch.allclose(fields(backbone, other, features)[:, :, heard], base[:, :, heard])


@pytest.mark.parametrize("kind", CREATE)
def test_every_shift_and_scale_is_used(kind: str) -> None:
    backbone, (x_t, features) = make_backbone(kind), inputs()
    modulation = backbone.modulate(torch.randn(2, 256), torch.tensor([0.4])).detach()
    modulation.requires_grad_()
    backbone(x_t, features, modulation).square().sum().backward()
    assert modulation.grad is not None
    # A shift just before a group's norm may cancel; nothing else may be without effect.
    assert (modulation.grad != 0).float().mean() > 0.999


@pytest.mark.parametrize("kind", CREATE)
def test_a_fresh_field_is_zero(kind: str) -> None:
    assert not fields(CREATE[kind](num_steps=45, feature_channels=3), *inputs()).any()
