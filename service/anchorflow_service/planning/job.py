"""A ticket: a job on its way through the queue, as long as somebody waits for it."""

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


class CalledOff(AnchorFlowError):
    """Nobody waits for this work any more; it ends the work and reaches no caller."""


@dataclass(frozen=True)
class Turn:
    """What a job is told when its turn has come."""

    queue_ms: float
    """How long it waited."""
    threads: int
    """That it may keep busy."""
    check: Callable[[], None]
    """To be called between steps; raises where nobody waits for the result any more."""


class Ticket(Generic[Result]):
    """A job that waits, is done by a lane, or is called off; whatever comes first ends it.

    Args:
        job: does the work, on a lane's thread.
        arrival: when the caller asked.
        budget_ms: from then on; None: the caller waits as long as it takes.
        key: jobs of the same key may make up a batch; None: this one is alone.
    """

    def __init__(
        self,
        job: Callable[[Turn], Result],
        arrival: Arrival,
        *,
        budget_ms: float | None = None,
        key: Hashable = None,
    ) -> None:
        self.arrival = arrival
        self.budget_ms = budget_ms
        self.key = key
        self.result: Future[Result] = Future()
        self.submitted = 0.0  # s, by the queue's clock
        self._job = job
        self._lock = threading.Lock()
        self._stage = "in the queue"
        # Else whoever stops waiting for the future would end it before `call_off` can.
        self.result.set_running_or_notify_cancel()

    @property
    def has_ended(self) -> bool:
        """Whether there is a result, or an error in its place."""
        return self.result.done()

    def check(self) -> None:
        """Raises `CalledOff` or `DeadlineExceeded` where nobody waits for the result any more."""
        if self.has_ended:
            raise CalledOff
        self.arrival.check(self.budget_ms, self._stage)

    def call_off(self, error: Exception) -> None:
        """End it with the error, unless it has ended; work on it stops at its next check."""
        self._end(partial(self.result.set_exception, error))

    def run_out(self) -> None:
        """Call it off because its budget is spent."""
        assert self.budget_ms is not None
        self.call_off(self.arrival.exceeded(self.budget_ms, self._stage))

    def work(self, *, queue_ms: float, threads: int) -> bool:
        """Do the job; whether it came to its end."""
        try:
            self.check()
            self._stage = "while planning"
            result = self._job(Turn(queue_ms, threads, self.check))
        except BaseException as error:  # noqa: BLE001 - raised again by whoever asks for the result
            self._end(partial(self.result.set_exception, error))
            return False
        self._end(partial(self.result.set_result, result))
        return True

    def _end(self, settle: Callable[[], None]) -> None:
        with self._lock:
            if not self.has_ended:
                settle()
