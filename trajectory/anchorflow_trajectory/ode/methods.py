"""Integration methods as data: a Butcher tableau checks its own order when it is built.

    k_i  = f(t + c_i h, x + h Σ_j a_ij k_j)
    x'   = x + h Σ_i b_i k_i

Order conditions: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, II.2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOLERANCE = 1e-12


def order_conditions(A: Array, b: Array, c: Array) -> Iterator[tuple[int, str, Any, float]]:
    """(order, formula, elementary weight, its value for the exact flow), one a rooted tree."""
    yield 1, "Σ b", b.sum(), 1.0
    yield 2, "b·c", b @ c, 1 / 2
    yield 3, "b·c²", b @ c**2, 1 / 3
    yield 3, "b·Ac", b @ A @ c, 1 / 6
    yield 4, "b·c³", b @ c**3, 1 / 4
    yield 4, "b·(c Ac)", b @ (c * (A @ c)), 1 / 8
    yield 4, "b·Ac²", b @ A @ c**2, 1 / 12
    yield 4, "b·AAc", b @ A @ A @ c, 1 / 24


MAX_ORDER = 4  # the conditions above go no further


@dataclass(frozen=True)
class ButcherTableau:
    """An explicit Runge-Kutta method.

    a_lower: row i holds a_i0 .. a_i,i-1; the first row is empty
    b:       [stages] weights of the step
    c:       [stages] node of each stage in the step, from 0 to 1
    order:   of convergence, 1 to 4; ValueError unless the coefficients have it
    """

    name: str
    a_lower: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: int

    def __post_init__(self) -> None:
        self._check_shape()
        A, b, c = self.matrix, np.array(self.b), np.array(self.c)
        self._check("row sums of a", A.sum(axis=1), c)
        for order, formula, weight, exact in order_conditions(A, b, c):
            if order <= self.order:
                self._check(f"{formula} (order {order})", weight, exact)

    @property
    def stages(self) -> int:
        return len(self.b)

    @property
    def slopes(self) -> int:
        """Return how many slopes a step weighs."""
        return self.stages

    def weights(self, schedule: tuple[float, ...], step: int) -> tuple[float, ...]:  # noqa: ARG002
        """b, whatever the step."""
        return self.b

    @property
    def matrix(self) -> Array:
        """a as a strictly lower triangular matrix [stages, stages]."""
        A = np.zeros((self.stages, self.stages))
        for i, row in enumerate(self.a_lower):
            A[i, :i] = row
        return A

    def _check_shape(self) -> None:
        rows = tuple(len(row) for row in self.a_lower)
        if rows != tuple(range(self.stages)) or len(self.c) != self.stages:
            raise ValueError(
                f"{self.name}: an explicit method of {self.stages} stages has rows of "
                f"{tuple(range(self.stages))} coefficients and {self.stages} nodes, "
                f"not {rows} and {len(self.c)}"
            )
        if not 1 <= self.order <= MAX_ORDER:
            raise ValueError(f"{self.name}: order {self.order} is not in 1..{MAX_ORDER}")

    def _check(self, what: str, got: Array | float, expected: Array | float) -> None:
        if not np.allclose(got, expected, rtol=0.0, atol=TOLERANCE):
            raise ValueError(f"{self.name}: {what} is {got}, expected {expected}")


EULER = ButcherTableau("euler", a_lower=((),), b=(1.0,), c=(0.0,), order=1)

MIDPOINT = ButcherTableau("midpoint", a_lower=((), (0.5,)), b=(0.0, 1.0), c=(0.0, 0.5), order=2)

HEUN = ButcherTableau("heun", a_lower=((), (1.0,)), b=(0.5, 0.5), c=(0.0, 1.0), order=2)

RK4 = ButcherTableau(
    "rk4",
    a_lower=((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
    c=(0.0, 0.5, 0.5, 1.0),
    order=4,
)


@dataclass(frozen=True)
class AdamsBashforth:
    """The explicit Adams method over the last `order` slopes; the first step is Euler's.

    x_{n+1} = x_n + h Σ_j β_j f_{n-j}, with one evaluation a step. The weights are exact for
    polynomials through the slopes' times, so steps may be unequal; the first steps use fewer slopes
    (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, III.1 and III.5).
    """

    name: str
    order: int

    a_lower: ClassVar[tuple[tuple[float, ...], ...]] = ((),)
    c: ClassVar[tuple[float, ...]] = (0.0,)
    stages: ClassVar[int] = 1

    @property
    def slopes(self) -> int:
        """Return how many slopes a step weighs, the newest first."""
        return self.order

    def weights(self, schedule: tuple[float, ...], step: int) -> tuple[float, ...]:
        """β of a step, as many as there are slopes by then."""
        return _weights(schedule, step, self.order)


@lru_cache(maxsize=256)
def _weights(schedule: tuple[float, ...], step: int, order: int) -> tuple[float, ...]:
    start, h = schedule[step], schedule[step + 1] - schedule[step]
    nodes = [(time - start) / h for time in islice(reversed(schedule[: step + 1]), order)]
    powers = np.arange(len(nodes))
    moments = 1.0 / (powers + 1)  # of s^k over the step, s from 0 to 1
    return tuple(np.linalg.solve(np.array(nodes) ** powers[:, None], moments).tolist())


Method = ButcherTableau | AdamsBashforth
"""A method with the stages of a Butcher tableau; a step may also weigh older slopes."""

AB2 = AdamsBashforth("ab2", order=2)

METHODS: dict[str, Method] = {method.name: method for method in (EULER, MIDPOINT, HEUN, RK4, AB2)}


def method_named(name: str) -> Method:
    """The method of that name; ValueError lists the known ones."""
    try:
        return METHODS[name]
    except KeyError:
        known = ", ".join(METHODS)
        raise ValueError(f"unknown method {name!r}, expected one of {known}") from None
