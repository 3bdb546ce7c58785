"""Cost fields: the maps of one scene, as the cost looks them up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.clearance import GridField

FloatArray = NDArray[np.floating]

TRAVERSABILITY, RISK = 1, 2  # channels of a cost map; 0 is occupancy


@dataclass(frozen=True)
class CostFields:
    """clearance: m beyond the robot's radius; soft: cost in [0, 1] of free ground, if any."""

    clearance: GridField
    soft: GridField | None = None

    @staticmethod
    def of(
        cost_map: FloatArray, clearance: FloatArray, resolution: float, origin: FloatArray
    ) -> CostFields:
        """Of a cost map [C, H, W] in [0, 1] whose clearance [H, W] is known."""
        field, soft = GridField(clearance, resolution, origin), soft_cost(cost_map)
        return CostFields(field, GridField(soft, resolution, origin) if soft.any() else None)


def soft_cost(cost_map: FloatArray) -> FloatArray:
    """[H, W] in [0, 1] of a map [C, H, W]: risky or hard to pass, whichever is worse."""
    soft = np.zeros(cost_map.shape[1:], np.float32)
    if len(cost_map) > TRAVERSABILITY:
        soft = np.maximum(soft, 1.0 - cost_map[TRAVERSABILITY])
    if len(cost_map) > RISK:
        soft = np.maximum(soft, cost_map[RISK])
    return soft
