"""GoalFlow behind a Transfuser backbone: cameras and LiDAR in place of the drawn raster.

The backbone's BEV is looked up at the raster's places, and one head says of each what the raster
would: drivable, and taken by others now and later. Everything behind it is GoalFlow's.
"""

from __future__ import annotations

import torch
from torch import Tensor

from anchorflow_models.goalflow.config import GoalFlowConfig
from anchorflow_models.goalflow.goalflow import Context, GoalFlow
from anchorflow_models.goalflow.networks import at_places
from anchorflow_models.transfuser import (
    STATUS_UNITS,
    GroundSight,
    OccupancyHead,
    TransfuserBackbone,
    moved_ahead,
)


class SensorGoalFlow(GoalFlow):
    """The network; `surface_logits` of its context are what the raster teaches."""

    places: Tensor
    status_units: Tensor

    def __init__(self, config: GoalFlowConfig) -> None:
        super().__init__(config)
        channels, rows, columns = config.seen
        self.backbone = TransfuserBackbone(config.transfuser)
        self.ground = GroundSight(config.transfuser) if config.ground_sight else None
        self.surface_head = OccupancyHead(channels, 2 + config.bev.foretold)
        low_x, high_x, low_y, high_y = config.bev.extent
        x = high_x - (high_x - low_x) * (torch.arange(rows) + 0.5) / rows
        y = high_y - (high_y - low_y) * (torch.arange(columns) + 0.5) / columns
        places = torch.stack(torch.meshgrid(x, y, indexing="ij"), -1)
        self.register_buffer("places", places, persistent=False)
        self.register_buffer("status_units", torch.tensor(STATUS_UNITS), persistent=False)

    def encode(  # type: ignore[override]  # of other inputs
        self,
        camera: Tensor,
        lidar: Tensor,
        ego_status: Tensor,
        vehicle_size: Tensor,
        lidar_before: Tensor | None = None,
        route: Tensor | None = None,
        goal: Tensor | None = None,
        score_weights: Tensor | None = None,
    ) -> Context:
        """camera, lidar, lidar_before: as `TransfuserBackbone`; the rest as `GoalFlow.encode`."""
        context = self.look(camera, lidar, ego_status, vehicle_size, lidar_before, route)
        return self.with_ways(context, ego_status, goal, score_weights)

    def look(  # type: ignore[override]  # of other inputs
        self,
        camera: Tensor,
        lidar: Tensor,
        ego_status: Tensor,
        vehicle_size: Tensor,
        lidar_before: Tensor | None = None,
        route: Tensor | None = None,
    ) -> Context:
        """Return the features of a scene, the route, and surface_logits [B, 2 + K, H, W]."""
        cells = self.sensed(camera, lidar, ego_status, lidar_before)
        logits = self.surface_head(cells)
        share = logits.sigmoid()
        surfaces = share[:, 0, :, :, None], share[:, 1:]
        context = self.seen(cells, surfaces, ego_status, vehicle_size, route)
        return context | {"surface_logits": logits}

    def sensed(
        self, camera: Tensor, lidar: Tensor, ego_status: Tensor, lidar_before: Tensor | None
    ) -> Tensor:
        """Return the BEV [B, C, H, W] at the raster's places; beyond the backbone's square it
        repeats the cells at its edge.
        """
        eyes, ahead = self.config.transfuser, 0.0
        reach = eyes.lidar_range
        bev = self.backbone(camera, lidar, lidar_before).upscaled
        if self.ground is not None:
            bev, ahead = moved_ahead(bev, eyes.ground_rows), eyes.ground_ahead
            bev = torch.cat([bev, self.ground(camera, bev, ego_status / self.status_units)], 1)
        extent = (ahead - reach, ahead + reach, -reach, reach)
        places = self.places.expand(bev.shape[0], -1, -1, -1)
        return at_places(bev.permute(0, 2, 3, 1), places, extent).permute(0, 3, 1, 2)


def create_goalflow(config: GoalFlowConfig) -> GoalFlow:
    """Return a network of that configuration, its weights drawn at random."""
    return (SensorGoalFlow if config.sensors else GoalFlow)(config)
