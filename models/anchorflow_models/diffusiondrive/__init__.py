"""DiffusionDriveV2: truncated diffusion from a few anchors, scored coarse to fine."""

from anchorflow_models.diffusiondrive.config import DiffusionDriveConfig as DiffusionDriveConfig
from anchorflow_models.diffusiondrive.planner import (
    DiffusionDriveV2 as DiffusionDriveV2,
    PerceivedScene as PerceivedScene,
    create_diffusiondrive as create_diffusiondrive,
)
