"""The ego status of a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import ego_status
from anchorflow_driving.log import COMMANDS
from anchorflow_driving.window import PlannerView


def status_of(view: PlannerView) -> NDArray[np.float32]:
    """The ego status [8] of a window; the rear axle moves along its heading."""
    state = view.state
    return ego_status(
        command=COMMANDS[view.command],
        velocity=(state.speed, 0.0),
        acceleration=(state.acceleration, state.speed**2 * state.curvature),
    )
