"""The networks, in torch: one folder a planner, over the shared `layers`. No I/O, no training."""

from anchorflow_models.flowmp import (
    CostMapEncoder as CostMapEncoder,
    FlowMPTransformer as FlowMPTransformer,
    FlowMPUNet1D as FlowMPUNet1D,
    L2Config as L2Config,
    L2SafetyCFM as L2SafetyCFM,
    create_flowmp_transformer as create_flowmp_transformer,
    create_flowmp_unet1d as create_flowmp_unet1d,
    create_l2_safety_cfm as create_l2_safety_cfm,
)
