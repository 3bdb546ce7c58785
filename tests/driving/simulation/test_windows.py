"""The command of a window, by the shared definition."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_driving.log import COMMANDS
from anchorflow_driving.simulation.windows import command


def bend(degrees: float) -> np.ndarray:
    """20 m straight on, a bend over 10 m, 60 m straight on; a point every 0.25 m."""
    heading = np.deg2rad(degrees) * np.clip((np.arange(0.0, 90.0, 0.25) - 20.0) / 10.0, 0.0, 1.0)
    return np.cumsum(0.25 * np.stack([np.cos(heading), np.sin(heading)], -1), axis=0)


@pytest.mark.parametrize(
    ("degrees", "end", "told"),
    [
        (60.0, 40.0, "left"),
        (-60.0, 40.0, "right"),
        (18.0, 40.0, "straight"),
        (22.0, 40.0, "left"),
        (60.0, 0.0, "straight"),  # stands: 15 m ahead, before the bend
        (60.0, 18.0, "left"),  # 10 m past the recorded end
    ],
)
def test_command(degrees: float, end: float, told: str) -> None:
    assert COMMANDS[command(bend(degrees), 0.0, end)] == told
