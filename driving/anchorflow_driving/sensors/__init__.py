"""What a planner's sensors would tell of a window, drawn from its log: simulated sensors."""

from __future__ import annotations

from anchorflow_driving.sensors.bev import BEV, BevGrid, draw_bev
from anchorflow_driving.sensors.status import UNKNOWN_COMMAND, ego_status, status_of

__all__ = ["BEV", "UNKNOWN_COMMAND", "BevGrid", "draw_bev", "ego_status", "status_of"]
