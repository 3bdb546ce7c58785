"""WoTE: camera and LiDAR in, anchors judged by a latent world model."""

from anchorflow_models.wote.config import RewardWeights as RewardWeights, WoteConfig as WoteConfig
from anchorflow_models.wote.stages import Judged as Judged, Moved as Moved, Seen as Seen
from anchorflow_models.wote.world_model import final_scores as final_scores
from anchorflow_models.wote.wote import WoTE as WoTE, create_wote as create_wote
