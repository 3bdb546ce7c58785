"""When to ask again after an error that passes, and when to give up. Waits for nothing itself."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from anchorflow_client.contract import AnchorRequest
from anchorflow_client.contract.checks import is_number
from anchorflow_client.errors import (
    AnchorFlowError,
    ConnectionFailed,
    NotReady,
    Overloaded,
    TimedOut,
)

RETRIED = (Overloaded, NotReady, ConnectionFailed, TimedOut)
"""What the same request may not meet a moment later."""

LONGEST_S = 1e6
"""Of a wait that is handed to the operating system, which cannot count to infinity."""

logger = logging.getLogger("anchorflow_client.retry")


def check_times(most: float = math.inf, /, **times_s: float) -> None:
    """Raises `ValueError` by its name for the first that is no number above 0, up to `most`."""
    for name, time_s in times_s.items():
        if not is_number(time_s) or not time_s > 0.0:
            raise ValueError(f"{name}: expected a number above 0, got {time_s}")
        if time_s > most:
            raise ValueError(f"{name}: expected at most {most:g} s, got {time_s}")


@dataclass(frozen=True, kw_only=True)
class Patience:
    """How long, and how often, something is asked again; `RetryingClient` says what is what."""

    patience_s: float
    first_pause_s: float
    longest_pause_s: float
    clock: Callable[[], float]
    draw: Callable[[], float]

    def __post_init__(self) -> None:
        """Raises `ValueError` where a time is not above 0."""
        names = ("patience_s", "first_pause_s", "longest_pause_s")
        times_s = {name: getattr(self, name) for name in names}
        check_times(**times_s)
        for name, time_s in times_s.items():
            object.__setattr__(self, name, float(time_s))

    def attempts(self, budget_ms: float | None = None) -> Attempts:
        """For one question, which is asked first now."""
        return Attempts(self, budget_ms)


class Attempts:
    """The attempts at one question."""

    def __init__(self, patience: Patience, budget_ms: float | None) -> None:
        self._patience = patience
        self._start = patience.clock()
        self._passed_s = 0.0
        budget_s = float("inf") if budget_ms is None else budget_ms / 1e3
        self._until_s = min(patience.patience_s, budget_s)
        self._pauses = doubling(patience.first_pause_s, patience.longest_pause_s)

    def what_is_left_of(self, request: AnchorRequest) -> AnchorRequest:
        """The request with its budget less what had passed before the attempt that begins."""
        if request.budget_ms is None or not self._passed_s:
            return request
        return replace(request, budget_ms=request.budget_ms - 1e3 * self._passed_s)

    def pause_s_after(self, error: AnchorFlowError) -> float:
        """How long to wait before the next attempt. Raises the error where there is none."""
        share = 0.5 + 0.5 * self._patience.draw()
        pause_s = at_least_told(next(self._pauses) * share, error)
        if self._now_s() + pause_s >= self._until_s:
            raise error
        logger.info("asking again in %.2f s: %s: %s", pause_s, type(error).__name__, error)
        return pause_s

    def go_on(self, error: AnchorFlowError) -> None:
        """The pause is over. Raises the error where it took too long."""
        self._passed_s = self._now_s()
        if self._passed_s >= self._until_s:
            raise error

    def _now_s(self) -> float:
        return self._patience.clock() - self._start


def doubling(first: float, longest: float) -> Iterator[float]:
    """Pauses after one failure, two failures, and so on for ever, in any unit."""
    pause = first
    while True:
        pause = min(pause, longest)
        yield pause
        pause *= 2.0


def at_least_told(pause_s: float, error: AnchorFlowError) -> float:
    """The pause, or the longer one that an overloaded service asked for."""
    told_s = error.retry_after_s if isinstance(error, Overloaded) else None
    return max(pause_s, told_s or 0.0)
