"""WoTE: camera and LiDAR in, anchors judged by a latent world model."""

from anchorflow_models.wote.config import RewardWeights, WoteConfig
from anchorflow_models.wote.stages import Judged, Moved, Seen
from anchorflow_models.wote.world_model import final_scores
from anchorflow_models.wote.wote import WoTE, create_wote

__all__ = [
    "Judged",
    "Moved",
    "RewardWeights",
    "Seen",
    "WoTE",
    "WoteConfig",
    "create_wote",
    "final_scores",
]
