"""The ego status: eight numbers, and each wrong one by its name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from anchorflow_client.errors import InvalidRequest
from anchorflow_driving.sensors import ego_status, status_of
from anchorflow_driving.window import Window


def test_command_velocity_acceleration() -> None:
    status = ego_status(command="right", velocity=(8.0, 0.1), acceleration=[-1.0, 0.5])

    np.testing.assert_allclose(status, [0, 0, 1, 0, 8.0, 0.1, -1.0, 0.5], rtol=1e-6)
    assert status.dtype == np.float32


def test_of_a_window(on_street: Callable[..., Window]) -> None:
    status = status_of(on_street(speed=7.0).view)

    np.testing.assert_allclose(status, [0, 1, 0, 0, 7, 0, 0, 0], atol=1e-5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"command": "back"},
            "command: expected one of left, straight, right, unknown, got 'back'",
        ),
        ({"velocity": (1.0,)}, r"velocity: expected shape \[2\], got \[1\]"),
        ({"acceleration": (0.0, np.nan)}, "acceleration: expected finite numbers"),
    ],
)
def test_what_is_wrong_is_named(wrong: dict[str, Any], message: str) -> None:
    right = {"command": "left", "velocity": (1.0, 0.0), "acceleration": (0.0, 0.0)}
    with pytest.raises(InvalidRequest, match=message):
        ego_status(**(right | wrong))
