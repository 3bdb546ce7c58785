"""The robot that is controlled: its kind, its body and its limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.body import DEFAULT_OMEGA_MAX, Kinematics, read_footprint
from anchorflow_client.contract.checks import Interval, expected, number
from anchorflow_client.contract.ranges import A_MAX, ROBOT_RADIUS, V_MAX

ALPHA_MAX = Interval(0.0, 1000.0, "rad/s^2", open_low=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A robot's kind, body and limits; commands and predicted motions keep the limits.

    | kind | state | command `u` |
    |---|---|---|
    | omni with a radius | x, y, heading, vx, vy | vx, vy |
    | differential, ackermann, omni with a footprint | x, y, heading, v, w | v, w |

    Positions are in the map's frame in m, headings in rad. The velocities vx and vy of an omni
    robot are in the *map's* frame too, in m/s, and its heading is kept. v is the speed forward in
    m/s, negative backwards, and w the turn rate in rad/s, positive to the left. An omni robot with
    a footprint drives along its heading and turns on the spot.

    Raises `InvalidRequest` for a wrong argument; it names the argument.
    """

    kind: str
    """omni, differential or ackermann, as in `Kinematics`."""
    v_max: float
    """m/s."""
    a_max: float
    """m/s^2; of an omni robot in every direction, of the others along the way, and as much again
    aside in a bend (v w)."""
    radius: float | None = None
    """m; of the disc, or None with a footprint."""
    footprint: NDArray[np.float64] | ArrayLike | None = None
    """[K,2] m, the corners of a convex outline about the robot's place, x forward; or None."""
    omega_max: float = DEFAULT_OMEGA_MAX
    """rad/s, of the turn rate."""
    alpha_max: float = 4.0
    """rad/s^2, of the change of the turn rate; a car's turn rate falls faster where it brakes."""
    min_turning_radius: float = 0.0
    """m; |w| is at most |v| / min_turning_radius. 0: it turns on the spot; ackermann needs more."""
    reverse: bool = False
    """Whether it may drive backwards."""
    reverse_v_max: float | None = None
    """m/s backwards; None for v_max."""

    def __post_init__(self) -> None:
        kinematics = Kinematics.from_fields(
            {name: getattr(self, name) for name in Kinematics.__dataclass_fields__}
        )
        for name, value in vars(kinematics).items():
            self._set(name, value)
        self._set("v_max", number(self.v_max, "v_max", V_MAX))
        self._set("a_max", number(self.a_max, "a_max", A_MAX))
        self._set("alpha_max", number(self.alpha_max, "alpha_max", ALPHA_MAX))
        if self.reverse_v_max is not None:
            self._set("reverse_v_max", number(self.reverse_v_max, "reverse_v_max", V_MAX))
        if (self.radius is None) == (self.footprint is None):
            raise expected("radius", "a radius or a footprint, and not both", self.radius)
        if self.radius is not None:
            self._set("radius", number(self.radius, "radius", ROBOT_RADIUS))
        else:
            self._set("footprint", read_footprint(self.footprint))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @property
    def is_omni(self) -> bool:
        """Whether it moves in any direction without turning."""
        return self.kind == "omni" and self.radius is not None

    @property
    def v_min(self) -> float:
        """m/s, the lowest speed forward: 0, or below it for a robot that may drive backwards."""
        if not self.reverse:
            return 0.0
        return -(self.v_max if self.reverse_v_max is None else min(self.reverse_v_max, self.v_max))

    @property
    def reach(self) -> float:
        """m from the robot's place to the farthest point of its body."""
        if self.radius is not None:
            return self.radius
        return float(np.linalg.norm(np.asarray(self.footprint), axis=1).max())

    @property
    def options(self) -> dict[str, Any]:
        """Return the fields of a request that describe this robot, as for `Planner.update`.

        An omni robot with a footprint is driven along its heading, so that its anchors are those of
        a differential drive that reverses.
        """
        asked: dict[str, Any] = {"v_max": self.v_max, "a_max": self.a_max}
        if self.is_omni:
            return asked | {"robot_radius": self.radius}
        names = Kinematics.__dataclass_fields__
        asked["kinematics"] = Kinematics(**{name: getattr(self, name) for name in names})
        if self.kind == "omni":
            asked["kinematics"] = Kinematics("differential", omega_max=self.omega_max, reverse=True)
        body = "robot_radius" if self.radius is not None else "footprint"
        return asked | {body: self.reach if self.radius is not None else self.footprint}
