"""The numbers that the contract fixes: defaults, and what each field may hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FEW = 16
"""Numbers that Python has compared by the time that numpy has begun."""


@dataclass(frozen=True)
class Interval:
    """Numbers from `low` to `high` in `unit`, both ends included unless open; it prints itself."""

    low: float
    high: float
    unit: str = ""
    open_low: bool = False
    open_high: bool = False

    def contains(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Element by element, whether it lies inside; a NaN lies in no interval."""
        values = np.asarray(values)
        above = values > self.low if self.open_low else values >= self.low
        below = values < self.high if self.open_high else values <= self.high
        return above & below

    def holds(self, number: float) -> bool:
        """Whether one number lies inside; a NaN does not."""
        above = number > self.low if self.open_low else number >= self.low
        below = number < self.high if self.open_high else number <= self.high
        return bool(above and below)

    def holds_all(self, values: NDArray[Any]) -> bool:
        """Whether every number lies inside: most often told by the least and the greatest."""
        if values.size <= FEW:
            inside = all(map(self.holds, values.ravel().tolist()))
        else:  # a NaN is the least and the greatest of all that it is among
            inside = self.holds(values.min()) and self.holds(values.max())
        # As `contains` compares: in the array's own type, in which 1.1 meets an end of 1.1.
        return inside or bool(self.contains(values).all())

    def __str__(self) -> str:
        left, right = "(" if self.open_low else "[", ")" if self.open_high else "]"
        return f"in {left}{self.low:g}, {self.high:g}{right} {self.unit}".rstrip()


DIMENSIONS = (2, 3)
"""D: x and y, or x, y and heading."""
STATE_FIELDS = 3
"""D-vectors of `x_curr`: position, velocity, acceleration."""
GOAL_FIELDS = 2
"""D-vectors of `x_goal`: position and velocity."""
NUM_STYLE = 3
"""Weights of `w_style`: safety, energy, smooth."""

DEFAULT_NUM_SAMPLES = 64
DEFAULT_TAU = 0.8

EIGHT_STEP_SCHEDULE = (0.0, 0.8, 0.85, 0.9, 0.92, 0.94, 0.96, 0.98, 1.0)
"""Flow times of the schedule that a request may call "8step"."""
METHODS = ("rk4", "heun", "midpoint", "euler", "ab2")

OCCUPIED = 0.5
"""Occupancy from which on a cell is an obstacle."""

MAX_SCENES = 64
MAX_CHANNELS = 8
MIN_MAP_CELLS, MAX_MAP_CELLS = 16, 512
"""Least and most cells along a side of the map."""
MAX_SCHEDULE_STEPS = 100
MAX_WARM_START_STEPS = 1024
MAX_AXES = 8
"""Of a tensor, B among them."""
MAX_TEXT_LENGTH = 128
MAX_INPUT_TEXT_LENGTH = 64 * 1024
"""Characters of an input that is a text, such as a prompt."""
MAX_PIXELS = 16 * 2**20
"""Of one picture; a file of a few kB may unpack to gigabytes."""
MAX_REQUEST_PIXELS = 2 * MAX_PIXELS
"""Of all pictures of one request, such as the two that V2X-VLM looks at."""

UNIT = Interval(0.0, 1.0)
INSIDE_UNIT = Interval(0.0, 1.0, open_low=True, open_high=True)
EVERY_NUMBER = Interval(-math.inf, math.inf)
COORDINATE = Interval(-1e7, 1e7, "m")
WARM_START = Interval(-1e7, 1e7)
STYLE_WEIGHT = Interval(0.0, 1e6)
RESOLUTION = Interval(1e-6, 100.0, "m/cell")
ROBOT_RADIUS = Interval(0.0, 5.0, "m")
V_MAX = Interval(0.0, 100.0, "m/s", open_low=True)
A_MAX = Interval(0.0, 1000.0, "m/s^2", open_low=True)
VELOCITY = Interval(-V_MAX.high, V_MAX.high, V_MAX.unit)
ACCELERATION = Interval(-100.0, 100.0, A_MAX.unit)
STATE = (COORDINATE, VELOCITY, ACCELERATION)
"""Of each component of the D-vectors of `x_curr` and `x_goal`, a heading's in rad."""
HORIZON = Interval(0.0, 600.0, "s", open_low=True)
TIME_STEP = Interval(0.0, 600.0, "s", open_low=True)
SAFETY_MARGIN = Interval(0.0, 5.0, "m")
CERTIFIED_MARGIN = Interval(0.0, 5.0, "m")
GUIDANCE = Interval(0.0, 100.0)
BUDGET = Interval(0.0, 1e7, "ms", open_low=True)
NUM_SAMPLES = Interval(1, 512)
SEED = Interval(0, 2**63 - 1)
