"""The end of a caller's patience."""

from __future__ import annotations

import time


class Deadline:
    """So much time from now on; 0 is left when it is over."""

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self._until = time.monotonic() + timeout_s

    @property
    def left_s(self) -> float:
        """Time left."""
        return max(0.0, self._until - time.monotonic())
