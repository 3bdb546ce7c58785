"""The learning rate's course."""

from __future__ import annotations

import math

FLOOR = 0.01  # share of the peak rate at which the cosine ends


def rate_share(step: int, *, warmup: int, steps: int) -> float:
    """The learning rate at a step as a share of its peak: linear warm-up, then a cosine."""
    if step < warmup:
        return (step + 1) / warmup
    done = (step - warmup) / max(1, steps - warmup)
    return FLOOR + (1 - FLOOR) * 0.5 * (1 + math.cos(math.pi * min(1.0, done)))
