"""Cancel a request from another thread, and bound the time that it may take."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from typing import Any

from anchorflow_client.errors import Cancelled


class Cancellation:
    """A flag that is set once, with callbacks for the threads that wait."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._is_cancelled = False
        self._callbacks: list[Callable[[], object]] = []

    @property
    def is_cancelled(self) -> bool:
        return self._is_cancelled

    def cancel(self) -> None:
        """Cancel every request that was given this object."""
        with self._lock:
            self._is_cancelled = True
            callbacks = list(self._callbacks)
        for callback in callbacks:
            callback()

    @contextmanager
    def watched_by(self, callback: Callable[[], object]) -> Iterator[None]:
        """Call `callback` if this is cancelled inside the block, or was before."""
        with self._lock:
            self._callbacks.append(callback)
            was_cancelled = self._is_cancelled
        if was_cancelled:
            callback()
        try:
            yield
        finally:
            with self._lock:
                self._callbacks.remove(callback)


class Deadline:
    """The deadline of a request, which can be cancelled before.

    Args:
        timeout_s: time from now on.
        cancellations: each cancels the request.
    """

    def __init__(self, timeout_s: float, *cancellations: Cancellation) -> None:
        self.timeout_s = timeout_s
        self._until = time.monotonic() + timeout_s
        self._cancellations = cancellations

    @property
    def left_s(self) -> float:
        """Return the time left, at least 0. Raises `Cancelled`."""
        self.check()
        return max(0.0, self._until - time.monotonic())

    def check(self) -> None:
        """Raise `Cancelled` if the request was cancelled."""
        if any(each.is_cancelled for each in self._cancellations):
            raise Cancelled("the request was taken back")

    def at_most(self, timeout_s: float) -> Deadline:
        """Return an earlier deadline within the time left. Raises `Cancelled`."""
        return Deadline(min(timeout_s, self.left_s), *self._cancellations)

    def wait_for(self, changed: threading.Condition, is_over: Callable[[], bool]) -> bool:
        """Wait as `changed.wait_for(is_over)` until the deadline. Raises `Cancelled`."""

        def wake() -> None:
            with changed:
                changed.notify_all()

        with self.watched_by(wake), changed:
            while not (over := is_over()) and (left_s := self.left_s):
                changed.wait(left_s)
            return over

    def wait_until_done(self, future: Future[Any]) -> bool:
        """Wait for the future, and return whether it is done. Raises `Cancelled`."""
        changed = threading.Event()
        future.add_done_callback(lambda _: changed.set())
        with self.watched_by(changed.set):
            changed.wait(self.left_s)
        self.check()
        return future.done()

    @contextmanager
    def watched_by(self, callback: Callable[[], object]) -> Iterator[None]:
        with ExitStack() as stack:
            for each in self._cancellations:
                stack.enter_context(each.watched_by(callback))
            yield
