"""Generation in torch: draws anchors from a network that was just trained, without a bundle.

A request is the contract's, with its checks and its `WarmStart`. The service's engine samples and
finishes the anchors; guidance by any torch cost, a control barrier inside the flow and the adaptive
solver rk45 exist only here.
"""

from anchorflow_client.contract import WarmStart as WarmStart
from anchorflow_models.generation.config import (
    AnchorTensors as AnchorTensors,
    GeneratorConfig as GeneratorConfig,
)
from anchorflow_models.generation.generator import (
    TrajectoryGenerator as TrajectoryGenerator,
    generate_trajectory_anchors as generate_trajectory_anchors,
)
from anchorflow_models.generation.scenes import (
    encode_inputs as encode_inputs,
    requested_scenes as requested_scenes,
)
from anchorflow_models.generation.steering import Guidance as Guidance
from anchorflow_models.layers.clearance_map import ClearanceMap as ClearanceMap
