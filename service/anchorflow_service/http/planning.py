"""The queue in front of the engines: blocking work on its own threads, never on the event loop."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import TypeVar

from anchorflow_client.errors import NotReady, Overloaded

Result = TypeVar("Result")

SMOOTHING = 0.2
"""Weight of the latest call in the running mean of the service time."""


class PlanningQueue:
    """Runs `workers` jobs at a time, lets `max_waiting` more wait, and refuses the rest.

    Open inside its `with` block only.
    """

    def __init__(self, *, workers: int, max_waiting: int) -> None:
        self._workers = workers
        self._capacity = workers + max_waiting
        self._executor: ThreadPoolExecutor | None = None
        # Workers and the event loop both count.
        self._lock = threading.Lock()
        self._in_flight = 0
        self._mean_service_s = 0.0

    @property
    def is_open(self) -> bool:
        """Whether it takes jobs."""
        return self._executor is not None

    async def run(self, job: Callable[[float], Result]) -> Result:
        """What `job(queue_ms)` returns, given the time that it waited for a worker.

        Raises:
            NotReady: the queue is not open.
            Overloaded: too many wait, with the time until a place is likely free.
        """
        if self._executor is None:
            raise NotReady("the service is starting or stopping")
        self._admit()
        future = self._executor.submit(self._timed, job, time.perf_counter())
        future.add_done_callback(self._leave)
        return await asyncio.wrap_future(future)

    def __enter__(self) -> PlanningQueue:
        self._executor = ThreadPoolExecutor(self._workers, thread_name_prefix="planning")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        executor, self._executor = self._executor, None
        if executor is not None:
            executor.shutdown(cancel_futures=True)

    def _admit(self) -> None:
        with self._lock:
            if self._in_flight >= self._capacity:
                raise self._overloaded()
            self._in_flight += 1

    def _leave(self, _: Future[Result]) -> None:
        with self._lock:
            self._in_flight -= 1

    def _overloaded(self) -> Overloaded:
        # Whole seconds, because Retry-After knows no others.
        wait_s = max(1, math.ceil(self._mean_service_s * self._in_flight / self._workers))
        waiting = self._in_flight - self._workers
        message = f"{waiting} requests wait already; try again in {wait_s} s"
        return Overloaded(message, retry_after_s=wait_s)

    def _timed(self, job: Callable[[float], Result], submitted: float) -> Result:
        started = time.perf_counter()
        try:
            return job((started - submitted) * 1e3)
        finally:
            self._observe(time.perf_counter() - started)

    def _observe(self, service_s: float) -> None:
        with self._lock:
            mean = self._mean_service_s or service_s
            self._mean_service_s = mean + SMOOTHING * (service_s - mean)
