"""A job: work that waits in line and runs on a lane while its result is wanted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.planning.call import Arrival

Result = TypeVar("Result")


class JobCancelled(AnchorFlowError):
    """Ends the work of a cancelled job; no caller sees it."""


@dataclass(frozen=True)
class JobContext:
    """Arguments of the work when it begins."""

    queue_ms: float
    """Time in the queue."""
    threads: int
    """Number of threads that the work may use."""
    check: Callable[[], None]
    """Call this between steps; it raises if the job was cancelled or its budget is spent."""


class Job(Generic[Result]):
    """Work that ends with a result, an error or its cancellation, whichever comes first.

    Args:
        work: the function to run, on a lane's thread.
        arrival: when the request arrived.
        budget_ms: time from then on; None: no limit.
        key: jobs of the same key may form a batch; None: this one never does.
        deliver: takes the result first, on the lane's thread, unless the job has ended.
    """

    def __init__(
        self,
        work: Callable[[JobContext], Result],
        arrival: Arrival,
        *,
        budget_ms: float | None = None,
        key: Hashable = None,
        deliver: Callable[[Result], object] | None = None,
    ) -> None:
        self.arrival = arrival
        self.budget_ms = budget_ms
        self.key = key
        self.result: Future[Result] = Future()
        self.has_ended = False
        """Whether there is a result or an error."""
        self.submitted = 0.0  # s, by the queue's clock
        self._work, self._deliver = work, deliver
        self._lock = threading.Lock()
        self._stage = "in the queue"
        # Otherwise cancelling the future would end it before `cancel` can.
        self.result.set_running_or_notify_cancel()

    def check(self) -> None:
        """Raise `JobCancelled` if the job has ended, `DeadlineExceeded` if its budget is spent."""
        if self.has_ended:
            raise JobCancelled
        self.arrival.check(self.budget_ms, self._stage)

    def cancel(self, error: Exception) -> None:
        """End the job with the error, unless it has ended; its work stops at the next check."""
        self._end(partial(self.result.set_exception, error))

    def expire(self) -> None:
        """Cancel the job because its budget is spent."""
        assert self.budget_ms is not None
        self.cancel(self.arrival.exceeded(self.budget_ms, self._stage))

    def run(
        self,
        *,
        queue_ms: float,
        threads: int,
        freed: Callable[[bool], None] = lambda _: None,
    ) -> bool:
        """Do the work; return whether it was completed.

        freed: called with the same before the result is set, whose receiver may submit a next job
        """
        try:
            self.check()
            self._stage = "while planning"
            result = self._work(JobContext(queue_ms, threads, self.check))
        except BaseException as error:  # noqa: BLE001 - raised by the future
            freed(False)
            self._end(partial(self.result.set_exception, error))
            return False
        freed(True)
        self._end(partial(self._hand_over, result))
        return True

    def _hand_over(self, result: Result) -> None:
        try:
            if self._deliver is not None:
                self._deliver(result)
        except BaseException as error:  # noqa: BLE001 - raised by the future
            self.result.set_exception(error)
        else:
            self.result.set_result(result)

    def _end(self, settle: Callable[[], None]) -> None:
        with self._lock:
            if self.has_ended:
                return
            self.has_ended = True
        settle()  # outside the lock, since callbacks of the future may take long


AnyJob = Job[Any]
