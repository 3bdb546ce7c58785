"""Real ROS messages; without ROS the tests of this folder skip by its name."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture(scope="session")
def make() -> Any:
    """Return a `ros_messages.Messages`."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'anchorflow[ros]'")
    from ros_messages import Messages

    return Messages()
