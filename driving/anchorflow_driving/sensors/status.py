"""The ego status: command, velocity and acceleration as one vector."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.errors import InvalidRequest
from anchorflow_driving.log import COMMANDS
from anchorflow_driving.window import PlannerView

UNKNOWN_COMMAND = "unknown"
STATUS_COMMANDS = (*COMMANDS, UNKNOWN_COMMAND)


def ego_status(
    *, command: str, velocity: ArrayLike, acceleration: ArrayLike
) -> NDArray[np.float32]:
    """[8]: the command as one of four, velocity x, y (m/s), acceleration x, y (m/s²).

    velocity, acceleration: of the rear axle, in its frame, x forward

    Raises:
        InvalidRequest: names `command`, `velocity` or `acceleration`.
    """
    if command not in STATUS_COMMANDS:
        known = ", ".join(STATUS_COMMANDS)
        raise InvalidRequest(f"expected one of {known}, got {command!r}", "command")
    vectors = {"velocity": velocity, "acceleration": acceleration}
    numbers = {name: np.asarray(value, np.float32) for name, value in vectors.items()}
    for name, value in numbers.items():
        if value.shape != (2,):
            raise InvalidRequest(f"expected shape [2], got {list(value.shape)}", name)
        if not np.isfinite(value).all():
            raise InvalidRequest(f"expected finite numbers, got {value.tolist()}", name)
    one_hot = np.array([name == command for name in STATUS_COMMANDS], np.float32)
    return np.concatenate([one_hot, *numbers.values()])


def status_of(view: PlannerView) -> NDArray[np.float32]:
    """The ego status [8] of a window; the rear axle moves along its heading."""
    state = view.state
    return ego_status(
        command=COMMANDS[view.command],
        velocity=(state.speed, 0.0),
        acceleration=(state.acceleration, state.speed**2 * state.curvature),
    )
