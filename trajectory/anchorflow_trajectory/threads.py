"""The cores of this process, and how loops are spread over threads."""

from __future__ import annotations

import os
from collections.abc import Callable

Spread = Callable[[Callable[[int, int], None], int], None]
"""Calls work(begin, end) for parts of `count` anchors, on as many threads as it likes."""


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):  # Linux alone has it
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_one(work: Callable[[int, int], None], count: int) -> None:
    """A `Spread` over the calling thread alone."""
    work(0, count)
