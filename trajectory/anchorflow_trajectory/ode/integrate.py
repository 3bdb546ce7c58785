"""The fast integrator: one loop for every explicit method, without temporary arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.ode.method import Method
from anchorflow_trajectory.ode.schedule import Schedule, stage_times

Array = NDArray[np.floating[Any]]


class VectorField(Protocol):
    """dx/dt at one of the distinct stage times."""

    def __call__(self, x: Array, time_index: int, out: Array) -> object:
        """Writes the field at x into out, of the same shape; what it returns is not looked at.

        time_index counts the times of `stage_times(method, schedule)`, so what depends on the
        time alone is worked out once for all of them.
        """
        ...


def integrate(
    vector_field: VectorField,
    x0: Array,
    *,
    schedule: Schedule,
    method: Method,
    on_step: Callable[[Array], object] = lambda _: None,
) -> Array:
    """x at the schedule's end, of x0's shape and dtype; x0 is left as it is.

    `on_step` sees x after each step, in a buffer that the next step overwrites.
    """
    x, point, term = x0.copy(), np.empty_like(x0), np.empty_like(x0)
    slopes = [np.empty_like(x0) for _ in range(method.slopes)]
    stages = stage_times(method, schedule).index
    for step, ((start, end), indices) in enumerate(zip(pairwise(schedule), stages, strict=True)):
        h = end - start
        slopes = [slopes[-1], *slopes[:-1]]  # a multistep method looks back; its oldest goes
        for row, index, slope in zip(method.a_lower, indices, slopes, strict=False):
            _advance(x, slopes, row, h, out=point, term=term)
            vector_field(point, index, slope)
        _advance(x, slopes, method.weights(schedule, step), h, out=x, term=term)
        on_step(x)
    return x


def _advance(
    x: Array,
    slopes: Sequence[Array],
    weights: Sequence[float],
    h: float,
    *,
    out: Array,
    term: Array,
) -> None:
    """out = x + h Σ weights_i slopes_i; out may be x."""
    if out is not x:
        np.copyto(out, x)
    for weight, slope in zip(weights, slopes, strict=False):  # a stage uses only the ones before it
        if weight:
            np.multiply(slope, h * weight, out=term)
            np.add(out, term, out=out)
