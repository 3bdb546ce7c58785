"""Linear multistep methods: one evaluation a step, beside the slopes of the steps before.

    x_{n+1} = x_n + h Σ_j β_j f_{n-j}

The weights make the step exact for polynomials through the slopes' times, so steps may be unequal;
the first steps look back on fewer slopes (Hairer, Nørsett, Wanner, Solving Ordinary Differential
Equations I, III.1 and III.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import ClassVar

import numpy as np


@dataclass(frozen=True)
class AdamsBashforth:
    """The explicit Adams method over the last `order` slopes; a first step is Euler's."""

    name: str
    order: int

    a_lower: ClassVar[tuple[tuple[float, ...], ...]] = ((),)
    c: ClassVar[tuple[float, ...]] = (0.0,)
    stages: ClassVar[int] = 1

    @property
    def slopes(self) -> int:
        """How many slopes a step weighs, the newest first."""
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
