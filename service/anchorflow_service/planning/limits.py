"""What the service spends on its callers before it refuses."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ServiceLimits:
    """Bounds on memory, on waiting and on what is done at a time."""

    max_body_bytes: int = 16 * 2**20
    """Longest body that is read; a longer one is `too_large`."""
    max_waiting: int = 64
    """Requests that may wait for their turn; one more is `overloaded`."""
    max_batch: int = 16
    """Requests of a micro-batch; 1: one after the other, each on all threads."""
    batch_wait_ms: float = 0.0
    """How long the first of a micro-batch waits for others. 0: a batch is what waits already."""
    threads: int | None = None
    """Shared by the requests that are planned at a time; None: the cores of this process."""

    def __post_init__(self) -> None:
        """Raises `ValueError` for a bound that leaves nothing."""
        for name, least in (("max_body_bytes", 1), ("max_waiting", 0), ("max_batch", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name}: expected at least {least}, got {getattr(self, name)}")
        if not 0.0 <= self.batch_wait_ms < float("inf"):
            raise ValueError(f"batch_wait_ms: expected 0 or more, got {self.batch_wait_ms}")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"threads: expected at least 1, got {self.threads}")
