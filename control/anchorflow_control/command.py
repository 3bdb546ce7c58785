"""The answer of a controller at each tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Command:
    """The velocity to hold until the next tick, and the motion that it begins."""

    u: NDArray[np.float64]
    """[2], as `Robot` says: vx, vy in m/s in the map's frame, or v in m/s and w in rad/s."""
    motion: NDArray[np.float64]
    """[T,3], x and y in m and heading in rad of the predicted motion at `times`."""
    times: NDArray[np.float64]
    """[T] s from now."""
    braking: bool
    """Whether it is the hardest braking, for the `reason` below."""
    cost: float
    """The predicted motion's, by which the controller compares motions; lower is better."""
    reason: str | None = None
    """Why the robot brakes; None if it does not."""
    anchor: int | None = None
    """Index of the anchor that the motion follows; None if it follows none. For `Planner.follow`.
    """
    sideways: float | None = None
    """rad, the heading of a robot whose `u` is vx, vy; None for one that drives along its heading.
    """

    @property
    def twist(self) -> NDArray[np.float64]:
        """[3], vx, vy in m/s and turn rate in rad/s in the robot's own frame, as ROS's Twist."""
        if self.sideways is None:
            return np.array([self.u[0], 0.0, self.u[1]])
        cos, sin = np.cos(self.sideways), np.sin(self.sideways)
        x, y = self.u
        return np.array([cos * x + sin * y, cos * y - sin * x, 0.0])
