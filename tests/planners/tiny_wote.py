"""WoTE as small as it can be: for tests of all but its size."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from anchorflow_models.transfuser import LIDAR_BEFORE, TransfuserConfig
from anchorflow_models.wote import WoTE, WoteConfig, create_wote

TINY = WoteConfig(
    anchors=12,
    width=16,
    heads=2,
    hidden=16,
    anchor_layers=1,
    offset_layers=1,
    world_layers=1,
    agents=4,
    agent_layers=1,
    semantic_classes=3,
    footprint=((0.0, 0.0), (3.0, 1.0)),
    backbone=TransfuserConfig(
        image_height=16,
        image_width=32,
        lidar_size=32,
        stem_width=4,
        widths=(4, 8),
        depths=(1, 1),
        fusion_layers=1,
        fusion_heads=2,
        bev_channels=4,
    ),
)
AHEAD = replace(
    TINY,
    ground_sight=True,
    encounters=((0.0, 0.0), (5.0, 0.0)),
    backbone=replace(
        TINY.backbone, image_height=32, image_width=128, lidar_size=128, lidar_before=True
    ),
)
"""The same, which looks at the road ahead and at whom an anchor meets."""


def tiny_wote(config: WoteConfig = TINY) -> WoTE:
    """Return a network with the same random weights every time."""
    torch.manual_seed(0)
    return create_wote(config).eval()


def sensors(config: WoteConfig = TINY, B: int = 2) -> dict[str, Tensor]:
    """Return the inputs of B scenes, all different."""
    generator = torch.Generator().manual_seed(1)
    sizes = dict(config.backbone.input_sizes())
    status = torch.zeros(B, 8)
    status[:, 1], status[:, 4] = 1.0, 15.0 * torch.rand(B, generator=generator)
    given = {
        "camera": torch.randint(
            0, 256, (B, *sizes["camera"]), dtype=torch.uint8, generator=generator
        ),
        "lidar": torch.rand(B, *sizes["lidar"], generator=generator),
        "ego_status": status,
    }
    if config.backbone.lidar_before:
        given[LIDAR_BEFORE] = torch.rand(B, *sizes[LIDAR_BEFORE], generator=generator)
    return given
