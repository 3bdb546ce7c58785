"""The plain reference: the sampler as a textbook writes it, to hold the fast ones against."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

from anchorflow_trajectory.ode.method import Method
from anchorflow_trajectory.ode.schedule import Schedule

PlainField = Callable[[Any, float], Any]
"""(x, t) -> dx/dt, of numpy arrays or of torch tensors."""


def integrate_plainly(field: PlainField, x: Any, *, schedule: Schedule, method: Method) -> Any:
    """x at the schedule's end from x at its beginning, one evaluation after the other.

    x: a numpy array or a torch tensor; every step makes new ones.
    """
    before: list[Any] = []
    for step, (start, end) in enumerate(pairwise(schedule)):
        h, slopes = end - start, []
        for row, c in zip(method.a_lower, method.c, strict=True):
            point = x + sum(h * a * k for a, k in zip(row, slopes, strict=True))
            slopes.append(field(point, start + c * h))
        before = [*slopes, *before]  # a multistep method looks back
        weights = method.weights(schedule, step)
        x = x + sum(h * b * k for b, k in zip(weights, before, strict=False))
    return x
