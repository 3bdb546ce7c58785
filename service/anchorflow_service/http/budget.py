"""The caller's time: counted from arrival, checked before work is spent and after."""

from __future__ import annotations

import time
from collections.abc import Callable

from anchorflow_client.errors import DeadlineExceeded


class Arrival:
    """The moment a request came in."""

    def __init__(self, *, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._arrived = clock()

    @property
    def elapsed_ms(self) -> float:
        """Time since then."""
        return (self._clock() - self._arrived) * 1e3

    def check(self, budget_ms: float | None, stage: str) -> None:
        """Raises `DeadlineExceeded`, naming the stage, where the budget is spent."""
        elapsed_ms = self.elapsed_ms
        if budget_ms is not None and elapsed_ms >= budget_ms:
            message = f"expected an answer within {budget_ms:g} ms, {elapsed_ms:.1f} ms had passed"
            raise DeadlineExceeded(f"{message} {stage}", "budget_ms")
