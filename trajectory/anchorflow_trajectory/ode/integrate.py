"""Integrate a flow from a Gaussian draw to data, in one loop for every explicit method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle, pairwise
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.ode.methods import Method
from anchorflow_trajectory.ode.schedule import Schedule, stage_times

Array = NDArray[np.floating[Any]]
State = TypeVar("State")


class VectorField(Protocol):
    """dx/dt at one of the distinct stage times."""

    def __call__(self, x: Array, time_index: int, out: Array) -> object:
        """Write the field at x into out, of the same shape; x stays.

        time_index: into the times of `stage_times(method, schedule)`, so that a field can
            precompute whatever depends on the time alone
        """
        ...


class States(Protocol[State]):
    """Storage and arithmetic of the loop's states, on any device."""

    def empty(self) -> State:
        """Return a new state to write into."""
        ...

    def add_scaled(self, x: State, slope: State, weight: float, *, out: State) -> object:
        """out = x + weight · slope; out may be x."""
        ...


@dataclass(frozen=True, eq=False)
class ArrayStates:
    """States as numpy arrays.

    term: of their shape and dtype, to multiply into
    """

    term: Array

    def empty(self) -> Array:
        return np.empty_like(self.term)

    def add_scaled(self, x: Array, slope: Array, weight: float, *, out: Array) -> None:
        np.multiply(slope, weight, out=self.term)
        np.add(x, self.term, out=out)


def integrate(
    vector_field: VectorField,
    x0: Array,
    *,
    schedule: Schedule,
    method: Method,
    on_step: Callable[[Array], object] = lambda _: None,
) -> Array:
    """Return x at the schedule's end, of x0's shape and dtype; x0 stays.

    on_step: takes x after each step, in a buffer that a later step overwrites
    """
    states = ArrayStates(np.empty_like(x0))
    return integrate_in(states, vector_field, x0, schedule=schedule, method=method, on_step=on_step)


def integrate_in(
    states: States[State],
    vector_field: Callable[[State, int, State], object],
    x0: State,
    *,
    schedule: Schedule,
    method: Method,
    on_step: Callable[[State], object] = lambda _: None,
) -> State:
    """Integrate as `integrate` does, with states that only `states` can handle."""
    x, buffers = x0, cycle((states.empty(), states.empty()))
    slopes = [states.empty() for _ in range(method.slopes)]
    stages = stage_times(method, schedule).index
    for step, ((start, end), indices) in enumerate(zip(pairwise(schedule), stages, strict=True)):
        h, point = end - start, next(buffers)
        slopes = [slopes[-1], *slopes[:-1]]  # a multistep method looks back; its oldest goes
        for row, index, slope in zip(method.a_lower, indices, slopes, strict=False):
            vector_field(_advanced(states, x, slopes, row, h, out=point), index, slope)
        x = _advanced(states, x, slopes, method.weights(schedule, step), h, out=point)
        on_step(x)
    return x


def _advanced(
    states: States[State],
    x: State,
    slopes: Sequence[State],
    weights: Sequence[float],
    h: float,
    *,
    out: State,
) -> State:
    """Return x + h Σ weights_i slopes_i, in out; x itself if all weights are 0."""
    for weight, slope in zip(weights, slopes, strict=False):  # a stage uses only the ones before it
        if weight:
            states.add_scaled(x, slope, h * weight, out=out)
            x = out
    return x


PlainField = Callable[[Any, float], Any]
"""(x, t) -> dx/dt, of numpy arrays or of torch tensors."""


def integrate_plainly(field: PlainField, x: Any, *, schedule: Schedule, method: Method) -> Any:
    """Integrate as a textbook writes it: the reference for the fast loops.

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


@compiled
def drawn(noise: NDArray[np.float32], basis: NDArray[np.float32]) -> NDArray[np.float32]:
    """Standard normal numbers [N, R] times a basis [R, S]: [N, S].

    A matrix product whose bytes depend on no other row and on no number of threads.
    """
    rows, size = basis.shape
    draws = np.zeros((len(noise), size), np.float32)
    for n in range(len(noise)):
        for row in range(rows):
            share = noise[n, row]
            for s in range(size):
                draws[n, s] += share * basis[row, s]
    return draws
