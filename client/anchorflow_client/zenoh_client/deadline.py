"""The end of a caller's patience."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from anchorflow_client.cancellation import Cancellation
from anchorflow_client.errors import Cancelled


class Deadline:
    """So much time from now on, unless the request is taken back before.

    Args:
        timeout_s: how long.
        cancellations: each takes the request back.
    """

    def __init__(self, timeout_s: float, *cancellations: Cancellation) -> None:
        self.timeout_s = timeout_s
        self._until = time.monotonic() + timeout_s
        self._cancellations = cancellations

    @property
    def left_s(self) -> float:
        """Time left; 0 when it is over. Raises `Cancelled`."""
        self.check()
        return max(0.0, self._until - time.monotonic())

    def check(self) -> None:
        """Raises `Cancelled` where the request was taken back."""
        if any(each.is_cancelled for each in self._cancellations):
            raise Cancelled("the request was taken back")

    def at_most(self, timeout_s: float) -> Deadline:
        """One for a part of the time that is left. Raises `Cancelled`."""
        return Deadline(min(timeout_s, self.left_s), *self._cancellations)

    def wait_for(self, changed: threading.Condition, is_over: Callable[[], bool]) -> bool:
        """Waits as `changed.wait_for(is_over)`, as long as time is left. Raises `Cancelled`."""

        def wake() -> None:
            with changed:
                changed.notify_all()

        with self.watched_by(wake), changed:
            while not (over := is_over()) and (left_s := self.left_s):
                changed.wait(left_s)
            return over

    @contextmanager
    def watched_by(self, tell: Callable[[], object]) -> Iterator[None]:
        """Calls `tell` where the request is taken back inside the block, or was before."""
        with ExitStack() as stack:
            for each in self._cancellations:
                stack.enter_context(each.watched_by(tell))
            yield
