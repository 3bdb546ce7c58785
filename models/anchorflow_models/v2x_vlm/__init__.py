"""V2X-VLM: two cameras, a sentence and 45 waypoints [1].

config      what fixes the network: a size of Florence-2 [2], its pictures, its prompt
network     pictures and tokens to hidden states, those to waypoints, and the losses

[1] You et al., V2X-VLM: End-to-End V2X Cooperative Autonomous Driving Through Large Vision-Language
    Models, 2024.
[2] Xiao et al., Florence-2: Advancing a Unified Representation for a Variety of Vision Tasks,
    CVPR 2024.
"""

from anchorflow_models.v2x_vlm.config import V2XConfig as V2XConfig
from anchorflow_models.v2x_vlm.network import V2XVLM as V2XVLM, create_v2x_vlm as create_v2x_vlm
