"""A job: work on its way through the queue, for as long as somebody waits for its result."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.planning.arrival import Arrival

Result = TypeVar("Result")


class JobCancelled(AnchorFlowError):
    """Nobody waits for this work any more; it ends the work and reaches no caller."""


@dataclass(frozen=True)
class JobContext:
    """What the work is told when it begins."""

    queue_ms: float
    """How long it waited."""
    threads: int
    """That it may keep busy."""
    check: Callable[[], None]
    """To be called between steps; raises where nobody waits for the result any more."""


class Job(Generic[Result]):
    """Work that waits, is done by a lane or is cancelled; whichever comes first ends the job.

    Args:
        work: the function to run, on a lane's thread.
        arrival: when the caller asked.
        budget_ms: from then on; None: the caller waits as long as it takes.
        key: jobs of the same key may make up a batch; None: this one is alone.
        deliver: takes the result first, on the lane's thread; not called once the job has ended.
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
        """Whether there is a result, or an error in its place."""
        self.submitted = 0.0  # s, by the queue's clock
        self._work, self._deliver = work, deliver
        self._lock = threading.Lock()
        self._stage = "in the queue"
        # Else whoever stops waiting for the future would end it before `cancel` can.
        self.result.set_running_or_notify_cancel()

    def check(self) -> None:
        """Raises `JobCancelled`, `DeadlineExceeded` where nobody waits for the result any more."""
        if self.has_ended:
            raise JobCancelled
        self.arrival.check(self.budget_ms, self._stage)

    def cancel(self, error: Exception) -> None:
        """End it with the error, unless it has ended; its work stops at the next check."""
        self._end(partial(self.result.set_exception, error))

    def expire(self) -> None:
        """Cancel it because its budget is spent."""
        assert self.budget_ms is not None
        self.cancel(self.arrival.exceeded(self.budget_ms, self._stage))

    def run(
        self,
        *,
        queue_ms: float,
        threads: int,
        freed: Callable[[bool], None] = lambda _: None,
    ) -> bool:
        """Do the work; whether it was completed.

        freed: told the same before anybody hears what came of it, who may ask for more at once
        """
        try:
            self.check()
            self._stage = "while planning"
            result = self._work(JobContext(queue_ms, threads, self.check))
        except BaseException as error:  # noqa: BLE001 - raised again by whoever asks for the result
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
        except BaseException as error:  # noqa: BLE001 - raised again by whoever asks for the result
            self.result.set_exception(error)
        else:
            self.result.set_result(result)

    def _end(self, settle: Callable[[], None]) -> None:
        with self._lock:
            if self.has_ended:
                return
            self.has_ended = True
        settle()  # what others do with the result keeps nobody waiting who would end it too
