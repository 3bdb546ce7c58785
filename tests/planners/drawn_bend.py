"""Sensors of a bend's windows without a graphics driver: its number in every picture."""

from __future__ import annotations

import numpy as np

from anchorflow_driving.window import Window
from anchorflow_training.driving.labels import semantic_bev, view_after
from anchorflow_training.driving.sensor_windows import VELOCITIES, Drawn, SensorSizes


def drawn(window: Window, sizes: SensorSizes, *, agents: int = 30) -> Drawn:
    """Replacement of `sensed`: its streets are real, and one agent in a few is kept."""
    pictures = {
        name: np.full(shape, window.index, np.uint8) for name, shape in sizes.shapes.items()
    }
    now, later = (
        semantic_bev(view, rows=sizes.lidar_size // 2, reach=sizes.lidar_range)
        for view in (window.view, view_after(window, 4.0))
    )
    return {
        **pictures,
        **{name: pictures[name] % 6 for name in sizes.histograms},
        "occupancy": pictures["occupancy"] % 2,
        "semantics": now,
        "future_semantics": later,
        "ego_status": np.eye(8, dtype=np.float32)[1],
        "future": window.recorded(np.arange(1, 9) / 2).astype(np.float32),
        "is_example": np.array(1, np.float32),
        "is_recorded": np.array(1, np.float32),
        "agents": np.ones((agents, 5), np.float32),
        **{name: np.ones((agents, 2), np.float32) for name in VELOCITIES},
        "agent_count": np.array(1),
        "far_others": np.ones((48, 5), np.float32),
        "far_velocity": np.ones((48, 2), np.float32),
        "far_count": np.array(1),
    }
