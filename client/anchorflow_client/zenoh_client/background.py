"""A slow call on a thread of its own, so that no caller waits longer than he allows."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Generic, TypeVar

from anchorflow_client.errors import TimedOut

Result = TypeVar("Result")

FRESH_S = 5.0
"""How long the outcome of a call that nobody waited for is still somebody's answer."""


class Background(Generic[Result]):
    """Calls a function, once at a time, whenever somebody wants its result."""

    def __init__(self, function: Callable[[], Result], *, name: str) -> None:
        self._function = function
        self._name = name
        self._lock = threading.Lock()
        self._running: _Run[Result] | None = None

    def result(self, timeout_s: float) -> Result:
        """What the call that runs, or one that is started, returns.

        Raises:
            TimedOut: it is not over by then, and goes on; the next to ask gets its result.
            Exception: what the function raises.
        """
        run = self._current()
        wait([run.future], timeout_s)
        if not run.future.done():
            raise TimedOut(f"{self._name}: not done within {timeout_s * 1e3:.0f} ms")
        with self._lock:
            if self._running is run:
                self._running = None
        return run.future.result()

    def _current(self) -> _Run[Result]:
        with self._lock:
            if self._running is None or self._running.is_stale:
                self._running = _Run(self._function, self._name)
            return self._running


class _Run(Generic[Result]):
    """One call, under way or over."""

    def __init__(self, function: Callable[[], Result], name: str) -> None:
        self.future: Future[Result] = Future()
        self._function = function
        self._ended = float("inf")
        threading.Thread(target=self._run, name=name, daemon=True).start()

    @property
    def is_stale(self) -> bool:
        return time.monotonic() - self._ended > FRESH_S

    def _run(self) -> None:
        try:
            self.future.set_result(self._function())
        except Exception as error:  # noqa: BLE001 - raised again where the result is wanted
            self.future.set_exception(error)
        self._ended = time.monotonic()
