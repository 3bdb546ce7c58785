"""A call, as its transport received it, and the job that does its work on a lane."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, TypeVar

from anchorflow_client.codec import Payload, ServiceCodec
from anchorflow_client.contract import ModelId
from anchorflow_client.errors import AnchorFlowError, DeadlineExceeded, InternalError

ANSWERED = "ok"
CANCELLED = "cancelled"
"""Outcomes beside the codes of the contract's errors."""


class Arrival:
    """The time at which a request arrived, from which its budget counts."""

    def __init__(self, *, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._arrived = clock()

    @property
    def elapsed_ms(self) -> float:
        return (self._clock() - self._arrived) * 1e3

    def is_after(self, other: Arrival) -> bool:
        """Return whether this request is the newer one."""
        return self._arrived > other._arrived

    def left_ms(self, budget_ms: float) -> float:
        """Return what remains of a budget, at least 0."""
        return max(0.0, budget_ms - self.elapsed_ms)

    def check(self, budget_ms: float | None, stage: str) -> None:
        """Raise `DeadlineExceeded`, naming the stage, if the budget is spent."""
        if budget_ms is not None and self.elapsed_ms >= budget_ms:
            raise self.exceeded(budget_ms, stage)

    def exceeded(self, budget_ms: float, stage: str) -> DeadlineExceeded:
        """Return the error of a request whose budget is spent."""
        message = f"expected an answer within {budget_ms:g} ms, {self.elapsed_ms:.1f} ms had passed"
        return DeadlineExceeded(f"{message} {stage}", "budget_ms")


@dataclass
class Call:
    """A request as its transport received it: its bytes, and fields sent beside them."""

    payload: Payload
    codec: ServiceCodec
    """Reads the request and writes the answer."""
    arrival: Arrival
    request_id: str
    """Used if the request has no id of its own, which replaces it once the request is read."""
    model: str | None = None
    """The model that the address names, if any."""
    budget_ms: float | None = None
    """A budget from beside the bytes; it overrides the one inside them."""
    transport: str = "http"
    deliver: Callable[[Payload], object] | None = None
    """Takes the answer on the planning thread, for transports that can send from any thread: the
    answer then need not wait for the event loop."""
    model_id: ModelId | None = field(default=None, init=False)
    """The model that was chosen."""
    timing_ms: Mapping[str, float] = field(default_factory=dict, init=False)
    """Durations of the answer's stages."""


class Observer:
    """Is told of every call on every transport; a subclass overrides what it needs.

    A method may be called from any thread, and must neither block nor fail.
    """

    def ended(self, call: Call, outcome: str) -> None:
        """Handle the end of a call: `ANSWERED`, `CANCELLED` or an error's code.

        An answered call has `model_id` and `timing_ms`.
        """

    def batch_planned(self, requests: int) -> None:
        """Handle a micro-batch of that many requests."""


def internal_error(request_id: str) -> InternalError:
    """Return the error for an unexpected exception, which only the log describes."""
    return InternalError(f"internal error; the log tells of request {request_id}")


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
