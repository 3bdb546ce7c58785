"""A slow call on a thread of its own, so that no caller waits longer than he allows."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

from anchorflow_client.errors import TimedOut
from anchorflow_client.zenoh_client.deadline import Deadline

Result = TypeVar("Result")

FRESH_S = 5.0
"""How long the outcome of a call that nobody waited for is still somebody's answer."""


class Background(Generic[Result]):
    """Calls a function, once at a time, whenever somebody wants its result."""

    def __init__(self, function: Callable[[], Result], *, name: str) -> None:
        self._function = function
        self._name = name
        self._changed = threading.Condition()
        self._running: _Run[Result] | None = None

    def result(self, deadline: Deadline) -> Result:
        """What the call that runs, or one that is started, returns.

        Raises:
            TimedOut: it is not over by then, and goes on; the next to ask gets its result.
            Cancelled: the caller gives up before; it goes on all the same.
            Exception: what the function raises.
        """
        run = self._current()
        if not deadline.wait_for(self._changed, run.future.done):
            raise TimedOut(f"{self._name}: not done within {deadline.timeout_s * 1e3:.0f} ms")
        with self._changed:
            if self._running is run:
                self._running = None
        return run.future.result()

    def _current(self) -> _Run[Result]:
        with self._changed:
            if self._running is None or self._running.is_stale:
                self._running = _Run(self._function, self._name)
                self._running.future.add_done_callback(self._tell)
            return self._running

    def _tell(self, _: Future[Result]) -> None:
        with self._changed:
            self._changed.notify_all()


class _Run(Generic[Result]):
    """One call, under way or over."""

    def __init__(self, function: Callable[[], Result], name: str) -> None:
        self.future: Future[Result] = Future()
        self._function = function
        self._ended = float("inf")
        # Not a daemon: Python cannot end while a thread is inside zenoh, and would abort.
        threading.Thread(target=self._run, name=name).start()

    @property
    def is_stale(self) -> bool:
        return time.monotonic() - self._ended > FRESH_S

    def _run(self) -> None:
        try:
            self.future.set_result(self._function())
        except Exception as error:  # noqa: BLE001 - raised again where the result is wanted
            self.future.set_exception(error)
        self._ended = time.monotonic()
