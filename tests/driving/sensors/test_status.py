"""The ego status of a made-up street."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from anchorflow_driving.sensors.inputs import status_of
from anchorflow_driving.window import Window


def test_command_velocity_acceleration(on_street: Callable[..., Window]) -> None:
    window = on_street(speed=7.0, window_command=np.array([2], np.uint8))

    np.testing.assert_allclose(status_of(window.view), [0, 0, 1, 0, 7, 0, 0, 0], atol=1e-5)
