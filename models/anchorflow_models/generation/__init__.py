"""Generation in torch: anchors of a planner that has just been trained, no bundle needed."""

from anchorflow_models.generation.anchors import Anchors
from anchorflow_models.generation.clearance_map import ClearanceMap
from anchorflow_models.generation.config import GeneratorConfig
from anchorflow_models.generation.generator import TrajectoryGenerator
from anchorflow_models.generation.guidance import Guidance
from anchorflow_models.generation.scenes import Scenes
from anchorflow_models.generation.warm_start import WarmStart

__all__ = [
    "Anchors",
    "ClearanceMap",
    "GeneratorConfig",
    "Guidance",
    "Scenes",
    "TrajectoryGenerator",
    "WarmStart",
]
