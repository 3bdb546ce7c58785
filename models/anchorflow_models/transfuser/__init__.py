"""The backbone of planners that see by camera and LiDAR, and its heads."""

from anchorflow_models.transfuser.backbone import BevFeatures, FeaturePyramid, TransfuserBackbone
from anchorflow_models.transfuser.camera_lift import (
    GROUND_WIDTH,
    FarSight,
    GroundSight,
    foretold_traffic,
    moved_ahead,
    with_far,
)
from anchorflow_models.transfuser.config import (
    LIDAR_BEFORE,
    MOTION,
    SEMANTIC_STRIDE,
    STATUS,
    STATUS_UNITS,
    TransfuserConfig,
)
from anchorflow_models.transfuser.footprint import (
    BevValues,
    Footprint,
    Places,
    bev_places,
    driven_by_car,
    placed,
)
from anchorflow_models.transfuser.heads import (
    AGENT_QUERIES,
    AGENT_STATE,
    AgentHead,
    GroundSemanticHead,
    OccupancyHead,
    Perceived,
    SemanticHead,
)
from anchorflow_models.transfuser.lidar_flow import Moving, SweepMotion
from anchorflow_models.transfuser.occupancy_lookup import FORETOLD_S, Encounters, foretold_times

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
    "Perceived",
    "Places",
    "SemanticHead",
    "SweepMotion",
    "TransfuserBackbone",
    "TransfuserConfig",
    "bev_places",
    "driven_by_car",
    "foretold_times",
    "foretold_traffic",
    "moved_ahead",
    "placed",
    "with_far",
]
