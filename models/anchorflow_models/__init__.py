"""The networks, in torch: one folder a planner, over the shared `layers`. No I/O, no training."""

from anchorflow_models.flowmp import (
    CostMapEncoder,
    FlowMPTransformer,
    FlowMPUNet1D,
    L2Config,
    L2SafetyCFM,
    create_flowmp_transformer,
    create_flowmp_unet1d,
    create_l2_safety_cfm,
)

__all__ = [
    "CostMapEncoder",
    "FlowMPTransformer",
    "FlowMPUNet1D",
    "L2Config",
    "L2SafetyCFM",
    "create_flowmp_transformer",
    "create_flowmp_unet1d",
    "create_l2_safety_cfm",
]
