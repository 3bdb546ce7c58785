"""The likely mistake behind a refused value, as the end of its error message.

Each function returns "" where none is likely. None of them imports the checks, which use them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

OTHER_UNITS: dict[str, tuple[tuple[float, str], ...]] = {
    "m": ((0.01, "centimetres"), (0.001, "millimetres")),
    "m/cell": ((0.01, "centimetres"), (0.001, "millimetres")),
    "m/s": ((0.01, "cm/s"), (1 / 3.6, "km/h")),
    "rad": ((math.pi / 180, "degrees"),),
    "rad/s": ((math.pi / 180, "degrees a second"),),
    "s": ((0.001, "milliseconds"),),
}
"""What else a number may be in, and its factor, by the unit that was expected."""
FAR_BEYOND = 2.0
"""Times its bound, from which on a number may be meant in another unit."""
HUGE = 1e9
"""From which on a number is in no unit."""
FAR_OFF = 3.0
"""Sides of the map from 0, beyond which a place may be meant in another unit."""
COARSE = 1.0
"""m/cell, from which on a resolution may be meant in centimetres."""
ROUND_ANGLE, TURN = 5.0, 360.0
PERCENT, BYTE = 100.0, 255.0
MOST_CHANNELS = 16
PLANE_STATES = {"x_curr": 6, "x_goal": 4}
LEFT_OUT = {"x_curr": "the velocity and the acceleration", "x_goal": "the velocity"}


def unit_hint(value: Any, low: float, high: float, unit: str) -> str:
    """Say in which unit a number beyond [low, high] would be inside."""
    if not isinstance(value, int | float | np.number) or not abs(value) < HUGE:
        return ""
    if abs(value) < FAR_BEYOND * max(abs(low), abs(high)):
        return ""
    for factor, name in OTHER_UNITS.get(unit, ()):
        if low <= factor * value <= high:
            return f"; is it in {name}? {value:g} {name} are {factor * value:.3g} {unit}"
    return ""


def map_hint(values: NDArray[Any]) -> str:
    """Say what a map holds whose numbers are not in [0, 1]."""
    if np.isnan(values).any():
        return "; layers may mark unknown cells so: choose a value for them"
    low, high = float(values.min()), float(values.max())
    if low < -1.0 or high > BYTE:
        return ""
    if high <= PERCENT:
        return "; per cent, as in a ROS OccupancyGrid? CostMap.from_occupancy_grid reads one"
    return "; 0 to 255, as in Nav2's costs or a picture? CostMap.from_nav2 reads the former"


def map_shape_hint(shape: tuple[int, ...]) -> str:
    """Say how the axes of a map may be meant."""
    if len(shape) == 2:
        return "; a single channel is [grid], [1,H,W]"
    if len(shape) in (3, 4) and shape[-1] <= MOST_CHANNELS < min(shape[-3:-1]):
        return "; are the channels last? They come before rows and columns"
    return ""


def states_hint(field: str, size: int) -> str:
    """Say what a state of `size` numbers may lack."""
    if field in LEFT_OUT and size == 2:
        return f"; after the position comes {LEFT_OUT[field]}: zeros if it rests"
    if PLANE_STATES.get(field) == 6 and size == 4:
        return "; the acceleration follows the velocity: zeros if it is unknown"
    return ""


def degrees_hint(headings: NDArray[Any]) -> str:
    """Say what headings of 10, 15, 20 and so on to 360 would be in rad.

    A heading that runs on hardly ever hits one, and no robot is stopped for having turned often.
    """
    size = np.abs(headings)
    is_likely = (size > ROUND_ANGLE) & (size <= TURN) & (size % ROUND_ANGLE == 0)
    if not is_likely.any():
        return ""
    turn = float(headings[is_likely][0])
    return f", got {turn:g}; is it in degrees? {turn:g} degrees are {math.radians(turn):.3g} rad"


def place_hint(
    x: float, y: float, *, low: NDArray[Any], high: NDArray[Any], resolution: float
) -> str:
    """Say what a place (x, y) off the map from `low` to `high`, both [2] m, may be meant as."""

    def is_on_it(x: float, y: float) -> bool:
        return bool(low[0] <= x <= high[0] and low[1] <= y <= high[1])

    is_centred, size = bool(np.allclose(low, -high)), float(np.max(high - low))
    if is_on_it(y, x):
        return f"; ({y:g}, {x:g}) is on it: are x and y swapped?"
    if is_centred and is_on_it(x + low[0], y + low[1]):
        return "; it would be on a map whose lower corner, `cost_map.origin`, is (0, 0)"
    for factor, name in OTHER_UNITS["m"]:
        if is_on_it(factor * x, factor * y) and max(abs(x), abs(y)) > FAR_OFF * size:
            return f"; is it in {name}?"
    if is_on_it(low[0] + resolution * x, low[1] + resolution * y):
        return "; is it in cells? Places are in metres"
    return ""


def resolution_hint(resolution: float) -> str:
    """Say that cells are large for a robot, where a map is refused that lies elsewhere."""
    if resolution < COARSE:
        return ""
    return f"; a cell is {resolution:g} m wide: is `cost_map.resolution` in centimetres?"
