"""How far along its route a drive has come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.lines import SPACING

Array = NDArray[np.float64]

OFF_ROUTE = 10.0
"""m beside the line, beyond which a vehicle drives elsewhere: two lanes and a half."""
BACK, ONWARDS = 5.0, 20.0
"""m of the line around the last place where the next one may be: a route may cross itself."""


class RouteProgress:
    """The place on a line of SPACING that is nearest to where a vehicle is, from `begin` m on.

    place: m from the line's first point
    aside: m from the line
    """

    def __init__(self, line: Array, *, begin: float) -> None:
        self._line, self._begin = line, begin
        self.place, self.aside = begin, 0.0

    @property
    def passed(self) -> float:
        """m of the route that are done."""
        return self.place - self._begin

    @property
    def is_lost(self) -> bool:
        """Whether the vehicle is not on its route any more."""
        return self.aside > OFF_ROUTE

    def advance(self, point: Array) -> None:
        """The vehicle is there now, [2]; from beside its route it does not get on."""
        low = max(round((self.place - BACK) / SPACING), 0)
        near = self._line[low : round((self.place + ONWARDS) / SPACING)]
        apart = np.linalg.norm(near - point, axis=1)
        self.aside = float(apart.min())
        if not self.is_lost:
            self.place = (low + int(apart.argmin())) * SPACING
