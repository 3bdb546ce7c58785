"""FlowMP: flow matching over position, velocity and acceleration, conditioned on a cost map."""

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.cost_map_encoder import CostMapEncoder
from anchorflow_models.flowmp.l2_safety_cfm import L2SafetyCFM, create_l2_safety_cfm
from anchorflow_models.flowmp.transformer import FlowMPTransformer, create_flowmp_transformer
from anchorflow_models.flowmp.unet1d import FlowMPUNet1D, create_flowmp_unet1d

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
