"""The backbone of planners that see by camera and LiDAR, and its heads."""

from anchorflow_models.transfuser.backbone import (
    BevFeatures as BevFeatures,
    FeaturePyramid as FeaturePyramid,
    TransfuserBackbone as TransfuserBackbone,
)
from anchorflow_models.transfuser.camera_lift import (
    GROUND_WIDTH as GROUND_WIDTH,
    FarSight as FarSight,
    GroundSight as GroundSight,
    foretold_traffic as foretold_traffic,
    moved_ahead as moved_ahead,
    with_far as with_far,
)
from anchorflow_models.transfuser.config import (
    LIDAR_BEFORE as LIDAR_BEFORE,
    MOTION as MOTION,
    SEMANTIC_STRIDE as SEMANTIC_STRIDE,
    STATUS as STATUS,
    STATUS_UNITS as STATUS_UNITS,
    TransfuserConfig as TransfuserConfig,
)
from anchorflow_models.transfuser.footprint import (
    BevValues as BevValues,
    Footprint as Footprint,
    Places as Places,
    bev_places as bev_places,
    driven_by_car as driven_by_car,
    placed as placed,
)
from anchorflow_models.transfuser.heads import (
    AGENT_QUERIES as AGENT_QUERIES,
    AGENT_STATE as AGENT_STATE,
    AgentHead as AgentHead,
    GroundSemanticHead as GroundSemanticHead,
    OccupancyHead as OccupancyHead,
    Perceived as Perceived,
    SemanticHead as SemanticHead,
)
from anchorflow_models.transfuser.lidar_flow import Moving as Moving, SweepMotion as SweepMotion
from anchorflow_models.transfuser.occupancy_lookup import (
    FORETOLD_S as FORETOLD_S,
    Encounters as Encounters,
    foretold_times as foretold_times,
)
