"""Transient errors worth retrying: when to try again, and when to give up. Does no I/O itself."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import replace

from anchorflow_client.contract import AnchorRequest
from anchorflow_client.contract.checks import is_number
from anchorflow_client.errors import (
    AnchorFlowError,
    ConnectionFailed,
    NotReady,
    Overloaded,
    TimedOut,
    UsageError,
)

RETRIED = (Overloaded, NotReady, ConnectionFailed, TimedOut)
"""Errors that the same request may not raise a moment later."""

MAX_WAIT_S = 1e6
"""Upper bound for every timeout: operating systems cannot wait for an infinite time."""

logger = logging.getLogger("anchorflow_client.retry")


def check_times(most: float = math.inf, /, **times_s: float) -> None:
    """Raise `UsageError` naming the first argument that is not a number above 0, up to `most`."""
    for name, time_s in times_s.items():
        if not is_number(time_s) or not time_s > 0.0:
            raise UsageError(f"{name}: expected a number above 0, got {time_s}")
        if time_s > most:
            raise UsageError(f"{name}: expected at most {most:g} s, got {time_s}")


class Attempts:
    """The attempts at one call; `RetryingClient` documents the arguments."""

    def __init__(
        self,
        budget_ms: float | None = None,
        *,
        patience_s: float,
        first_pause_s: float,
        longest_pause_s: float,
        clock: Callable[[], float],
        draw: Callable[[], float],
    ) -> None:
        self._clock = clock
        self._draw = draw
        self._start = clock()
        self._elapsed_s = 0.0
        budget_s = math.inf if budget_ms is None else budget_ms / 1e3
        self._until_s = min(patience_s, budget_s)
        self._pauses = exponential_backoff(first_pause_s, longest_pause_s)

    def remaining(self, request: AnchorRequest) -> AnchorRequest:
        """Return the request with its budget reduced by the time that earlier attempts took."""
        if request.budget_ms is None or not self._elapsed_s:
            return request
        return replace(request, budget_ms=request.budget_ms - 1e3 * self._elapsed_s)

    def pause_after(self, error: AnchorFlowError) -> float:
        """Return the seconds to wait before the next attempt; raise `error` if there is none."""
        share = 0.5 + 0.5 * self._draw()
        pause_s = at_least_retry_after(next(self._pauses) * share, error)
        if self._now_s() + pause_s >= self._until_s:
            raise error
        logger.info("retrying in %.2f s: %s: %s", pause_s, type(error).__name__, error)
        return pause_s

    def resume(self, error: AnchorFlowError) -> None:
        """Begin the next attempt after the pause; raise `error` if the pause took too long."""
        self._elapsed_s = self._now_s()
        if self._elapsed_s >= self._until_s:
            raise error

    def _now_s(self) -> float:
        return self._clock() - self._start


def exponential_backoff(first: float, longest: float) -> Iterator[float]:
    """Yield pauses that double from `first` up to `longest`, in any unit, without end."""
    pause = first
    while True:
        pause = min(pause, longest)
        yield pause
        pause *= 2.0


def at_least_retry_after(pause_s: float, error: AnchorFlowError) -> float:
    """Return the pause, or the longer `retry_after_s` of an overloaded service."""
    retry_after_s = error.retry_after_s if isinstance(error, Overloaded) else None
    return max(pause_s, retry_after_s or 0.0)
