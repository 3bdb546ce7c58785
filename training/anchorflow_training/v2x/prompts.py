"""What the model is told: the scene, the vehicle and the task."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import into_frame

Array = NDArray[np.float64]

TASK = "Plan its path for 4.5 seconds."
UNTOLD = "Plan."
"""In place of a prompt, where a model learns without any."""
NEAR = 40.0
"""m, within which others are told of."""
STANDING = 0.3  # m/s


def prompt(*, speed: float, turn_rate: float, scene: str) -> str:
    """speed in m/s, turn_rate in rad/s to the left; scene: what a captioner says of it, or ''"""
    state = f"The ego vehicle drives at {max(speed, 0.0):.1f} m/s"
    if speed < STANDING:
        state = f"The ego vehicle stands at {max(speed, 0.0):.1f} m/s"
    elif abs(turn_rate) >= 0.02:
        side = "left" if turn_rate > 0 else "right"
        state += f", turning {side} by {abs(turn_rate):.2f} rad/s"
    return " ".join(part for part in (scene, f"{state}.", TASK) if part)


def seen_scene(boxes: Array, pose: Array) -> str:
    """How many others there are near a pose [3], of boxes [n,5], and where the nearest ahead is."""
    local = into_frame(boxes[:, :2], pose)
    near = local[np.linalg.norm(local, axis=1) < NEAR]
    if not len(near):
        return "No other vehicle is near."
    others = f"{len(near)} other vehicle" + ("s are near" if len(near) > 1 else " is near")
    ahead = near[(near[:, 0] > 0) & (np.abs(near[:, 1]) < 2.5)]
    if not len(ahead):
        return f"{others}."
    return f"{others}, one {ahead[:, 0].min():.0f} m ahead."
