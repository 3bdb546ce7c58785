"""What there is to imitate in a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.drivers import PLAN_TIMES, constant_velocity, idm
from anchorflow_driving.log import DRIVEN
from anchorflow_driving.window import Window

ASTRAY = 1.5
"""m between where an example is at its first time and where the ego would be at its velocity."""


def example(window: Window) -> NDArray[np.float64] | None:
    """Poses [T, 3] at PLAN_TIMES: what was driven or, where a planner under test drove, what
    PDM-Closed would do from there; None where that does not go on as the ego moves, as it has no
    route to follow any more.
    """
    if window.log.source != DRIVEN:
        return window.recorded(PLAN_TIMES)
    poses = idm(window)
    begun = poses[0] - constant_velocity(window)[0]
    is_near = bool(np.isfinite(poses).all()) and float(np.hypot(*begun[:2])) <= ASTRAY
    return poses if is_near else None
