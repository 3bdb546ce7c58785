"""What the service spends on its callers before it refuses."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Bounds on memory and on waiting."""

    max_body_bytes: int = 16 * 2**20
    """Longest body that is read; a longer one is `too_large`."""
    max_waiting: int = 64
    """Requests that may wait for a free worker; one more is `overloaded`."""
    workers: int = 1
    """Engine calls at a time; one already keeps every core busy."""
