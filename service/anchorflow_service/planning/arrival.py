"""The caller's time: counted from arrival, checked before work is spent, during it and after."""

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

    def is_after(self, other: Arrival) -> bool:
        """Whether this request is the newer one."""
        return self._arrived > other._arrived

    def left_ms(self, budget_ms: float) -> float:
        """What remains of a budget; 0 where it is spent."""
        return max(0.0, budget_ms - self.elapsed_ms)

    def check(self, budget_ms: float | None, stage: str) -> None:
        """Raises `DeadlineExceeded`, naming the stage, where the budget is spent."""
        if budget_ms is not None and self.elapsed_ms >= budget_ms:
            raise self.exceeded(budget_ms, stage)

    def exceeded(self, budget_ms: float, stage: str) -> DeadlineExceeded:
        """The refusal of a request whose budget is spent."""
        message = f"expected an answer within {budget_ms:g} ms, {self.elapsed_ms:.1f} ms had passed"
        return DeadlineExceeded(f"{message} {stage}", "budget_ms")
