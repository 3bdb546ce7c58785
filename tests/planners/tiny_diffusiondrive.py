"""DiffusionDriveV2 as small as it can be, of random weights: what its tests export and train."""

from __future__ import annotations

import torch
from flowmp_scenes import open_branches

from anchorflow_models.diffusiondrive import (
    DiffusionDriveConfig,
    DiffusionDriveV2,
    create_diffusiondrive,
)
from anchorflow_models.transfuser import TransfuserConfig

TINY = DiffusionDriveConfig(
    backbone=TransfuserConfig(
        image_height=16,
        image_width=32,
        lidar_size=16,
        stem_width=8,
        widths=(8, 8),
        depths=(1, 1),
        stem_pooling=False,
        fusion_layers=1,
        fusion_heads=2,
        bev_channels=8,
    ),
    classes=3,
    width=16,
    heads=2,
    hidden=32,
    query_layers=1,
    anchors=4,
    denoiser_layers=1,
    scorer_width=16,
    scorer_heads=2,
    scorer_hidden=32,
    fine_layers=1,
    value_kernel=1,
    look_heads=2,
    ego_motion=True,
    footprint=((0.0, 0.0), (3.0, 1.0)),
    vocabulary=3,
    groups=2,
    variants=2,
    keep=6,
)


def tiny_diffusiondrive(config: DiffusionDriveConfig = TINY) -> DiffusionDriveV2:
    """Return a network of random weights, including those that begin at zero."""
    torch.manual_seed(0)
    model = create_diffusiondrive(config).eval()
    open_branches(model)
    with torch.no_grad():
        model.vocabulary[..., 0] = (
            torch.linspace(0.5, 8.0, 8) * torch.arange(len(model.vocabulary))[:, None]
        )
    return model
