"""The robot's body: its outline, and how its wheels let it move."""

# No `from __future__ import annotations`: the rows are read out of the annotations below.
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.checks import frozen, numbers, wrong_shape
from anchorflow_client.contract.ranges import BODY_COORDINATE, OMEGA_MAX, TURNING_RADIUS
from anchorflow_client.contract.rows import Array, Flag, Group, Number, Text, rows_of
from anchorflow_client.errors import InvalidRequest

KINDS = ("omni", "differential", "ackermann")
DEFAULT_OMEGA_MAX = 1.5
LEAST_CORNERS, MOST_CORNERS = 3, 16
FLAT = 1e-9  # m^2: three corners in a row turn by no less


@dataclass(frozen=True)
class Kinematics:
    """How the robot moves; all but "omni" without a footprint plan in x, y and heading."""

    kind: Annotated[
        str,
        Text(
            "omni: any way, at any heading if it has a footprint; differential: along its heading, "
            "and turning on the spot; ackermann: like a car. A footprint without kinematics drives "
            "along its heading, in both directions.",
            KINDS,
            required=True,
        ),
    ]
    min_turning_radius: Annotated[
        float,
        Number("Radius of the tightest turn; required for ackermann.", TURNING_RADIUS, default=0.0),
    ] = 0.0
    omega_max: Annotated[
        float, Number("Limit of the turn rate.", OMEGA_MAX, default=DEFAULT_OMEGA_MAX)
    ] = DEFAULT_OMEGA_MAX
    reverse: Annotated[bool, Flag("The robot may drive backwards.", default=False)] = False

    @classmethod
    def from_fields(cls, value: Any) -> "Kinematics":
        value = vars(value) if isinstance(value, Kinematics) else value
        asked = cls(**KINEMATICS.read(value, "kinematics"))
        if asked.kind == "ackermann" and asked.min_turning_radius == 0.0:
            message = "expected a radius above 0 m for ackermann, got none"
            raise InvalidRequest(message, "kinematics.min_turning_radius")
        return asked


def read_footprint(value: Any) -> NDArray[np.float64]:
    """Return a convex outline's corners [K,2] in m, counter-clockwise. Raises `InvalidRequest`."""
    field = "footprint"
    corners = numbers(value, field, FOOTPRINT.interval, FOOTPRINT.shape)
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise wrong_shape(field, f"[K,2], K from {LEAST_CORNERS} to {MOST_CORNERS}", corners)
    if not LEAST_CORNERS <= (came := len(corners)) <= MOST_CORNERS:
        raise InvalidRequest(
            f"expected {LEAST_CORNERS} to {MOST_CORNERS} corners, got {came}", field
        )
    if _turns(corners).sum() < 0.0:
        corners = corners[::-1].copy()
    turns = _turns(corners)
    winds_once = np.isclose(_angles(corners).sum(), 2.0 * np.pi)
    if (turns <= FLAT).any() or not winds_once:
        at = int(np.argmin(turns))
        corner = "({:g}, {:g}) m".format(*corners[at])
        raise InvalidRequest(
            f"expected a convex polygon, got a corner at {corner} that is not", field
        )
    edge = np.roll(corners, -1, 0) - corners
    if (edge[:, 0] * corners[:, 1] - edge[:, 1] * corners[:, 0] >= 0.0).any():
        raise InvalidRequest(
            "expected a polygon about (0, 0) of the robot, got one beside it", field
        )
    return frozen(corners)


def inner_radius(corners: NDArray[np.float64]) -> float:
    """Return m from the robot's origin to the nearest edge of a footprint [K,2]."""
    edge = np.roll(corners, -1, 0) - corners
    apart = edge[:, 1] * corners[:, 0] - edge[:, 0] * corners[:, 1]
    return float((apart / np.hypot(edge[:, 0], edge[:, 1])).min())


def _turns(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross products [K] of the edges into and out of each corner."""
    into, out = corners - np.roll(corners, 1, 0), np.roll(corners, -1, 0) - corners
    return into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0]


def _angles(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles [K] in rad by which the outline turns at its corners."""
    into, out = corners - np.roll(corners, 1, 0), np.roll(corners, -1, 0) - corners
    return np.arctan2(_turns(corners), (into * out).sum(-1))


FOOTPRINT = Array(
    "Corners of the robot's convex outline about its origin, x forward; by default a disc of "
    "robot_radius.",
    "[K,2]",
    ((LEAST_CORNERS, MOST_CORNERS), (2, 2)),
    BODY_COORDINATE,
    unit="m",
    tensor="footprint",
)
KINEMATICS = Group(
    "How the robot moves; with wheels or a footprint, x_curr, x_goal and anchors have a heading.",
    rows_of(Kinematics),
)
