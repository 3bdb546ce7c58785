"""A simulated clock, and an executor whose results arrive after their measured latency."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from itertools import count
from time import perf_counter
from typing import Any

from anchorflow_client.errors import AnchorFlowError

TOLERANCE_S = 1e-9  # of sums of ticks


class SimulatedTime:
    """A clock that only `advance` moves: `clock()` returns the time in s."""

    def __init__(self) -> None:
        self.now = 0.0
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()

    def __call__(self) -> float:
        return self.now

    def at(self, moment: float, callback: Callable[[], None]) -> None:
        """Call `callback` once the clock has reached a moment."""
        heapq.heappush(self._due, (moment, next(self._order), callback))

    def advance(self, seconds: float) -> None:
        """Advance the clock and run the callbacks that are due."""
        self.now += seconds
        while self._due and self._due[0][0] <= self.now + TOLERANCE_S:
            heapq.heappop(self._due)[2]()


class LatencyExecutor(Executor):
    """Runs tasks at once and completes their futures after the measured time, in simulated time.

    stopwatch: measures the time in s
    fixed_s: replaces the measured time, so that a run can be repeated exactly
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
        """Run the function now; an `AnchorFlowError` becomes the future's."""
        future: Future[Any] = Future()
        start = self._stopwatch()
        try:
            finish = partial(future.set_result, fn(*args, **kwargs))
        except AnchorFlowError as error:
            finish = partial(future.set_exception, error)
        latency_s = self._stopwatch() - start if self._fixed_s is None else self._fixed_s
        self.latencies_s.append(latency_s)
        self._clock.at(self._clock.now + latency_s, finish)
        return future
