"""Where a request's time goes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

STAGES = ("queue", "encode", "sample", "refine", "total")


class StageClock:
    """Adds up the wall-clock time [ms] of a request's stages; the queue is the server's to fill."""

    def __init__(self) -> None:
        self.elapsed_ms: dict[str, float] = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds the time spent inside to that of the stage."""
        start = perf_counter()
        try:
            yield
        finally:
            self.elapsed_ms[name] += (perf_counter() - start) * 1e3
