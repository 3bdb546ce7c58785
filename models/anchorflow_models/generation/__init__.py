"""Generation in torch: anchors of a planner that has just been trained, no bundle needed.

A request is the contract's, and so are its checks and its `WarmStart`.
"""

from anchorflow_client.contract import WarmStart
from anchorflow_models.generation.anchor_tensors import AnchorTensors
from anchorflow_models.generation.clearance_map import ClearanceMap
from anchorflow_models.generation.config import GeneratorConfig
from anchorflow_models.generation.generator import TrajectoryGenerator
from anchorflow_models.generation.guidance import Guidance
from anchorflow_models.generation.scenes import encode_inputs, requested_scenes
from anchorflow_models.generation.trajectory_anchors import generate_trajectory_anchors

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
