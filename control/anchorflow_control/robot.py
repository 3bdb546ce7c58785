"""The robot that is controlled: its kind, its body and its limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.checks import Interval, boolean, choice, expected, number, numbers
from anchorflow_client.contract.ranges import A_MAX, ROBOT_RADIUS, V_MAX
from anchorflow_client.errors import InvalidRequest

Kind = Literal["omni", "differential", "ackermann"]

TURN = Interval(0.0, 100.0, "rad/s", open_low=True)
TURN_ACCELERATION = Interval(0.0, 1000.0, "rad/s^2", open_low=True)
TURNING_RADIUS = Interval(0.0, 100.0, "m")
OUTLINE = Interval(-10.0, 10.0, "m")


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A robot's kind, body and limits; commands and predicted motions keep the limits.

    | kind | state | command `u` |
    |---|---|---|
    | omni | x, y, heading, vx, vy | vx, vy |
    | differential, ackermann | x, y, heading, v, w | v, w |

    Positions are in the map's frame in m, headings in rad. The velocities vx and vy of an omni
    robot are in the *map's* frame too, in m/s, and its heading is kept. v is the speed forward in
    m/s, negative backwards, and w the turn rate in rad/s, positive to the left.

    Raises `InvalidRequest` for a wrong argument; it names the argument.
    """

    kind: Kind
    v_max: float
    """m/s."""
    a_max: float
    """m/s^2; of an omni robot in every direction, of the others along the way, and as much again
    aside in a bend (v w)."""
    radius: float | None = None
    """m; of the disc, or None with a footprint."""
    footprint: NDArray[np.float64] | ArrayLike | None = None
    """[K,2] m, the corners of the body, x forward from the robot's place; its convex hull counts.
    """
    omega_max: float = 2.0
    """rad/s, of the turn rate."""
    alpha_max: float = 4.0
    """rad/s^2, of the change of the turn rate; a car's turn rate falls faster where it brakes."""
    min_turning_radius: float = 0.0
    """m; |w| is at most |v| / min_turning_radius. 0 lets a differential robot turn on the spot;
    an ackermann robot requires more."""
    reverse: bool = False
    """Whether it may drive backwards."""
    reverse_v_max: float | None = None
    """m/s backwards; None for v_max."""

    def __post_init__(self) -> None:
        choice(self.kind, "kind", get_args(Kind))
        boolean(self.reverse, "reverse")
        self._set("v_max", number(self.v_max, "v_max", V_MAX))
        self._set("a_max", number(self.a_max, "a_max", A_MAX))
        self._set("omega_max", number(self.omega_max, "omega_max", TURN))
        self._set("alpha_max", number(self.alpha_max, "alpha_max", TURN_ACCELERATION))
        least = number(self.min_turning_radius, "min_turning_radius", TURNING_RADIUS)
        if self.kind == "ackermann" and least == 0.0:
            raise expected("min_turning_radius", "m above 0 for an ackermann robot", 0.0)
        self._set("min_turning_radius", least)
        if self.reverse_v_max is not None:
            self._set("reverse_v_max", number(self.reverse_v_max, "reverse_v_max", V_MAX))
        if (self.radius is None) == (self.footprint is None):
            raise expected("radius", "a radius or a footprint, and not both", self.radius)
        if self.radius is not None:
            self._set("radius", number(self.radius, "radius", ROBOT_RADIUS))
        else:
            self._set("footprint", _outline(self.footprint))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @property
    def v_min(self) -> float:
        """m/s, the lowest speed forward; of an omni robot -v_max."""
        if self.kind == "omni":
            return -self.v_max
        if not self.reverse:
            return 0.0
        return -(self.v_max if self.reverse_v_max is None else min(self.reverse_v_max, self.v_max))

    @property
    def reach(self) -> float:
        """m from the robot's place to the farthest point of its body."""
        if self.radius is not None:
            return self.radius
        return float(np.linalg.norm(np.asarray(self.footprint), axis=1).max())


def _outline(footprint: object) -> NDArray[np.float64]:
    """Return the corners [K,2] of a body that has an area."""
    corners = numbers(footprint, "footprint", OUTLINE, "[K,2]")
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        came = list(corners.shape)
        raise InvalidRequest(f"expected shape [K,2] with K from 3, got {came}", "footprint")
    if np.linalg.matrix_rank(corners - corners.mean(0), tol=1e-6) < 2:
        raise InvalidRequest("expected corners of an area, got a line or a point", "footprint")
    corners.setflags(write=False)
    return corners


def wrapped(angle: float) -> float:
    """Return the angle within -pi to pi."""
    return math.remainder(angle, math.tau)
