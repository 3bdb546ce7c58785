"""What a controller returns at each tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.robot import Kind


@dataclass(frozen=True, kw_only=True, eq=False)
class Command:
    """The velocity to hold until the next tick, and the motion that it begins."""

    u: NDArray[np.float64]
    """[2]; omni: vx, vy in m/s in the map's frame; else v in m/s and turn rate in rad/s."""
    motion: NDArray[np.float64]
    """[T,3], x and y in m and heading in rad of the predicted motion at `times`."""
    times: NDArray[np.float64]
    """[T] s from now."""
    braking: bool
    """Whether it is the hardest braking; `reason` tells why."""
    cost: float
    """Of the predicted motion, as the controller compares motions; lower is better."""
    reason: str | None = None
    """Why the robot brakes; None if it does not."""
    anchor: int | None = None
    """Index of the anchor that the motion follows; None if it follows none. For `Planner.follow`.
    """
    kind: Kind
    """Of the robot."""
    heading: float
    """rad, of the robot's state."""

    @property
    def twist(self) -> NDArray[np.float64]:
        """[3], vx, vy in m/s and turn rate in rad/s in the robot's own frame, as ROS's Twist."""
        if self.kind != "omni":
            return np.array([self.u[0], 0.0, self.u[1]])
        ahead, aside = np.cos(self.heading), np.sin(self.heading)
        x, y = self.u
        return np.array([ahead * x + aside * y, ahead * y - aside * x, 0.0])
