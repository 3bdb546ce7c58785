"""Faults in the levels of diagnostic_msgs, and a watch over the clock."""

from __future__ import annotations

from dataclasses import dataclass

OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""


@dataclass(frozen=True)
class Fault:
    """A message of one part of the node, and how serious it is."""

    part: str
    level: int
    text: str


class Stopped(Exception):
    """The robot cannot drive; `fault` says why."""

    def __init__(self, part: str, text: str) -> None:
        super().__init__(f"{part}: {text}")
        self.fault = Fault(part, ERROR, text)


class ClockWatch:
    """Compares the clock of the messages' stamps with one that never jumps.

    A simulated clock may be slow, but it neither goes back, nor leaps, nor stands.
    """

    def __init__(self, jump_s: float, stands_s: float) -> None:
        """Set the least jump in s that counts, and the s of real time in which a clock moves."""
        self._jump_s, self._stands_s = jump_s, stands_s
        self._now: float | None = None
        self._moved_at = self._steady = 0.0

    def jump(self, now: float, steady: float) -> float:
        """Take the time on both clocks; return the s by which the first one jumped, or 0."""
        first, moved, passed = self._now is None, now - (self._now or 0.0), steady - self._steady
        if first or moved != 0.0:
            self._moved_at = steady
        self._now, self._steady = now, steady
        if first or 0.0 <= moved <= passed + self._jump_s:
            return 0.0
        return moved

    def check(self) -> None:
        """Raise `Stopped` if the clock stands."""
        stands = self._steady - self._moved_at
        if stands > self._stands_s:
            raise Stopped("clock", f"it has been at {self._now:.2f} s for {stands:.2f} s")
