"""The backbone of planners that see by camera and LiDAR, and its heads."""

from anchorflow_models.transfuser.backbone import BevFeatures, FeaturePyramid, TransfuserBackbone
from anchorflow_models.transfuser.bev_values import BevValues, bev_places
from anchorflow_models.transfuser.config import (
    LIDAR_BEFORE,
    SEMANTIC_STRIDE,
    TransfuserConfig,
)
from anchorflow_models.transfuser.encounters import FORETOLD_S, Encounters, foretold_times
from anchorflow_models.transfuser.far_sight import FarSight, with_far
from anchorflow_models.transfuser.footprint import (
    Footprint,
    Places,
    driven_by_car,
    placed,
)
from anchorflow_models.transfuser.ground_sight import GROUND_WIDTH, GroundSight, moved_ahead
from anchorflow_models.transfuser.heads import (
    AGENT_QUERIES,
    AGENT_STATE,
    AgentHead,
    GroundSemanticHead,
    OccupancyHead,
    SemanticHead,
)
from anchorflow_models.transfuser.status import MOTION, STATUS, STATUS_UNITS
from anchorflow_models.transfuser.sweep_motion import Moving, SweepMotion

__all__ = [
    "AGENT_QUERIES",
    "AGENT_STATE",
    "FORETOLD_S",
    "GROUND_WIDTH",
    "LIDAR_BEFORE",
    "MOTION",
    "SEMANTIC_STRIDE",
    "STATUS",
    "STATUS_UNITS",
    "AgentHead",
    "BevFeatures",
    "BevValues",
    "Encounters",
    "FarSight",
    "FeaturePyramid",
    "Footprint",
    "GroundSemanticHead",
    "GroundSight",
    "Moving",
    "OccupancyHead",
    "Places",
    "SemanticHead",
    "SweepMotion",
    "TransfuserBackbone",
    "TransfuserConfig",
    "bev_places",
    "driven_by_car",
    "foretold_times",
    "moved_ahead",
    "placed",
    "with_far",
]
