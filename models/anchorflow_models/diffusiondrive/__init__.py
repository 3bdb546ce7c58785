"""DiffusionDriveV2: truncated diffusion from a few anchors, scored coarse to fine."""

from anchorflow_models.diffusiondrive.config import DiffusionDriveConfig
from anchorflow_models.diffusiondrive.planner import (
    DiffusionDriveV2,
    PerceivedScene,
    create_diffusiondrive,
)

__all__ = [
    "DiffusionDriveConfig",
    "DiffusionDriveV2",
    "PerceivedScene",
    "create_diffusiondrive",
]
