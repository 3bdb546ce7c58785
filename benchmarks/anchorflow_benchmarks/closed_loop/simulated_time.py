"""Simulated time, and answers that arrive in it as late as they took to work out."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from concurrent.futures import Executor, Future
from itertools import count
from time import perf_counter
from typing import Any

from anchorflow_client.errors import AnchorFlowError

SAME_MOMENT = 1e-9  # s, by which sums of ticks may differ


class SimulatedTime:
    """A clock that stands still until it is told to go on: `clock()` is the time in s."""

    def __init__(self) -> None:
        self.now = 0.0
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()

    def __call__(self) -> float:
        return self.now

    def at(self, moment: float, happen: Callable[[], None]) -> None:
        """Call `happen` once the clock has reached a moment."""
        heapq.heappush(self._due, (moment, next(self._order), happen))

    def advance(self, seconds: float) -> None:
        """Go on, and let happen what is due by then."""
        self.now += seconds
        while self._due and self._due[0][0] <= self.now + SAME_MOMENT:
            heapq.heappop(self._due)[2]()


class LatencyExecutor(Executor):
    """Runs what is submitted at once; in simulated time it is done as much later as it took.

    stopwatch: s, by which that is measured
    fixed_s: takes the place of the time that was measured, so that a run can be repeated exactly
    """

    def __init__(
        self,
        clock: SimulatedTime,
        *,
        stopwatch: Callable[[], float] = perf_counter,
        fixed_s: float | None = None,
    ) -> None:
        self.latencies_s: list[float] = []
        self._clock = clock
        self._stopwatch = stopwatch
        self._fixed_s = fixed_s

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Blocks while it runs; an `AnchorFlowError` is the future's."""
        future: Future[Any] = Future()
        start = self._stopwatch()
        result, failed = None, None
        try:
            result = fn(*args, **kwargs)
        except AnchorFlowError as error:
            failed = error
        latency_s = self._stopwatch() - start if self._fixed_s is None else self._fixed_s
        self.latencies_s.append(latency_s)

        def finish() -> None:
            if failed is None:
                future.set_result(result)
            else:
                future.set_exception(failed)

        self._clock.at(self._clock.now + latency_s, finish)
        return future
