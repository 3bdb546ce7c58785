"""The service time: how long a request takes, and therefore how long those behind it wait."""

from __future__ import annotations

import math

SMOOTHING = 0.2
"""Weight of the latest request in the running mean."""


class ServiceTimeEstimate:
    """A running mean of the time that a request takes a lane, and what follows from it."""

    def __init__(self, lanes: int) -> None:
        self._lanes = lanes
        self.mean_s = 0.0
        """0 before the first request."""

    def observe(self, service_s: float) -> None:
        """One more request was done."""
        mean = self.mean_s or service_s
        self.mean_s = mean + SMOOTHING * (service_s - mean)

    def wait_s(self, ahead: int) -> float:
        """Time until a lane is likely free for one who has so many ahead, at work or waiting."""
        return self.mean_s * ahead / self._lanes

    def retry_after_s(self, ahead: int) -> int:
        """The same in whole seconds, at least one, because Retry-After knows no others."""
        return max(1, math.ceil(self.wait_s(ahead)))
