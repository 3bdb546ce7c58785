"""The Transfuser backbone: shapes, attention between sensors, independence of scenes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from small_configs import BACKBONE as SMALL
from torch import Tensor

from anchorflow_models.transfuser import (
    AgentHead,
    GroundSemanticHead,
    SemanticHead,
    TransfuserBackbone,
    TransfuserConfig,
)


def backbone(config: TransfuserConfig = SMALL) -> TransfuserBackbone:
    torch.manual_seed(0)
    return TransfuserBackbone(config).eval()


def sensors(config: TransfuserConfig = SMALL, B: int = 2) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    sizes = dict(config.input_sizes())
    camera = torch.randint(0, 256, (B, *sizes["camera"]), dtype=torch.uint8, generator=generator)
    return camera, torch.rand(B, *sizes["lidar"], generator=generator)


@torch.no_grad()
def test_the_small_shapes() -> None:
    seen = backbone()(*sensors())
    assert seen.features.shape == (2, 96, 8, 8)
    assert seen.upscaled.shape == (2, 32, 64, 64)
    assert SemanticHead(SMALL, 8)(seen.upscaled).shape == (2, 8, 128, 256)


def test_the_published_sizes() -> None:
    config = TransfuserConfig()
    assert dict(config.input_sizes()) == {"camera": (3, 256, 1024), "lidar": (1, 256, 256)}
    assert (config.image_grid, config.bev_size, config.bev_width) == ((8, 32), 8, 512)
    assert (config.upscaled_size, config.semantic_size) == (64, (128, 256))


@pytest.mark.parametrize("changed", ["camera", "lidar"])
@torch.no_grad()
def test_the_bev_hears_both_sensors(changed: str) -> None:
    network, (camera, lidar) = backbone(), sensors()
    before = network(camera, lidar).features
    after = network(255 - camera, lidar) if changed == "camera" else network(camera, 1 - lidar)
    assert (after.features - before).abs().max() > 1e-3


@torch.no_grad()
def test_what_lies_ahead_on_the_left_is_in_the_first_row_and_column() -> None:
    network = backbone(replace(SMALL, fusion_layers=0))
    for fusion in network.fusions:  # nothing is mixed, so a place stays a place
        fusion.align_fused.weight.zero_()  # type: ignore[union-attr,operator]
        fusion.align_fused.bias.zero_()  # type: ignore[union-attr,operator]
    camera, empty = torch.zeros(1, 3, 128, 512, dtype=torch.uint8), torch.zeros(1, 1, 256, 256)
    told = empty.clone()
    told[..., 250, 250] = 1.0  # x and y near 32 m
    changed = (network(camera, told).features - network(camera, empty).features).abs().sum(1)[0]
    assert changed.argmax() == 0
    assert changed[4:, 4:].max() < changed[0, 0] / 10


@torch.no_grad()
def test_only_what_lies_ahead_is_told_by_the_semantic_head() -> None:
    torch.manual_seed(0)
    head, upscaled = SemanticHead(SMALL, 8), torch.rand(1, 32, 32, 32)
    before = head(upscaled)
    behind, ahead = upscaled.clone(), upscaled.clone()
    behind[:, :, 16:], ahead[:, :, :16] = 0, 0
    torch.testing.assert_close(head(behind), before)
    assert (head(ahead) - before).abs().max() > 1e-3


@torch.no_grad()
def test_the_same_half_of_a_bev_that_lies_ahead_and_each_cell_s_parts() -> None:
    torch.manual_seed(0)
    head, bev = GroundSemanticHead(SMALL, 16, 8), torch.rand(1, 16, 64, 64)
    before = head(bev)
    assert before.shape == (1, 8, 128, 256)
    elsewhere = bev.clone()
    elsewhere[:, :, :23] = elsewhere[:, :, 57:] = 0.0  # beyond 33 m, and behind
    torch.testing.assert_close(head(elsewhere), before)
    changed = bev.clone()
    changed[:, :, 24 + 5, 7] = 0.0  # and its neighbours, by the convolution
    apart = (head(changed) - before).abs().amax((0, 1))
    assert apart[4 * 4 : 4 * 7, 4 * 6 : 4 * 9].min() > 0.0
    assert apart[4 * 5 : 4 * 6, 4 * 7 : 4 * 8].unique().numel() == 16
    apart[4 * 4 : 4 * 7, 4 * 6 : 4 * 9] = 0.0
    assert apart.max() == 0.0


@torch.no_grad()
def test_boxes_stay_within_reach() -> None:
    torch.manual_seed(0)
    states, logits = AgentHead(16, 32, reach=32.0)(100 * torch.randn(2, 30, 16))
    assert (states.shape, logits.shape) == ((2, 30, 5), (2, 30))
    assert 16 < states[..., :2].abs().max() <= 32
    assert states[..., 2].abs().max() <= torch.pi


TWO_SWEEPS = replace(SMALL, lidar_before=True)


@torch.no_grad()
def test_an_earlier_sweep_is_heard_and_may_be_missing() -> None:
    network, (camera, lidar) = backbone(TWO_SWEEPS), sensors()
    shown = network(camera, lidar, 1 - lidar).features
    missing = network(camera, lidar).features
    assert (shown - missing).abs().max() > 1e-3
    torch.testing.assert_close(network(camera, lidar, torch.zeros_like(lidar)).features, missing)
    assert dict(TWO_SWEEPS.input_sizes())["lidar_before"] == (1, 256, 256)


@torch.no_grad()
def test_skips_begin_as_nothing_and_then_bring_the_finer_stages() -> None:
    network = backbone(replace(SMALL, pyramid_skips=True))
    camera, lidar = sensors()
    plain = network(camera, lidar)
    without = network.pyramid(plain.features, [torch.zeros(2, w, 8, 8) for w in SMALL.widths[:-1]])
    torch.testing.assert_close(without, plain.upscaled)
    for weight in network.pyramid.skips.parameters():
        weight.normal_()
        changed = network(camera, lidar)
        assert (changed.upscaled - plain.upscaled).abs().max() > 1e-3
        weight.zero_()
