"""Generation in torch: draws anchors from a network that was just trained, without a bundle.

A request is the contract's, with its checks and its `WarmStart`. The service's engine samples and
finishes the anchors; guidance by any torch cost, a control barrier inside the flow and the adaptive
solver rk45 exist only here.
"""

from anchorflow_client.contract import WarmStart
from anchorflow_models.generation.config import AnchorTensors, GeneratorConfig
from anchorflow_models.generation.generator import TrajectoryGenerator, generate_trajectory_anchors
from anchorflow_models.generation.scenes import encode_inputs, requested_scenes
from anchorflow_models.generation.steering import Guidance
from anchorflow_models.layers.clearance_map import ClearanceMap

__all__ = [
    "AnchorTensors",
    "ClearanceMap",
    "GeneratorConfig",
    "Guidance",
    "TrajectoryGenerator",
    "WarmStart",
    "encode_inputs",
    "generate_trajectory_anchors",
    "requested_scenes",
]
