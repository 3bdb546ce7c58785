"""FlowMP: flow matching over position, velocity and acceleration, conditioned on a cost map."""

from anchorflow_models.flowmp.config import L2Config as L2Config
from anchorflow_models.flowmp.cost_map_encoder import CostMapEncoder as CostMapEncoder
from anchorflow_models.flowmp.l2_safety_cfm import (
    L2SafetyCFM as L2SafetyCFM,
    create_l2_safety_cfm as create_l2_safety_cfm,
)
from anchorflow_models.flowmp.transformer import (
    FlowMPTransformer as FlowMPTransformer,
    create_flowmp_transformer as create_flowmp_transformer,
)
from anchorflow_models.flowmp.unet1d import (
    FlowMPUNet1D as FlowMPUNet1D,
    create_flowmp_unet1d as create_flowmp_unet1d,
)
