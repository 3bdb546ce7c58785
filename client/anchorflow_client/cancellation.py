"""A way to take a request back from another thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Cancellation:
    """Set once, never unset; whoever waits under `watched_by` is told at once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._is_cancelled = False
        self._watchers: list[Callable[[], object]] = []

    @property
    def is_cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._is_cancelled

    def cancel(self) -> None:
        """Take back every request that was given this."""
        with self._lock:
            self._is_cancelled = True
            watchers = list(self._watchers)
        for tell in watchers:
            tell()

    @contextmanager
    def watched_by(self, tell: Callable[[], object]) -> Iterator[None]:
        """Calls `tell` where this is cancelled inside the block, or was before."""
        with self._lock:
            self._watchers.append(tell)
            told_before = self._is_cancelled
        if told_before:
            tell()
        try:
            yield
        finally:
            with self._lock:
                self._watchers.remove(tell)
