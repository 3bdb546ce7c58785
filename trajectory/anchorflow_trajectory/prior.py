"""Draws of a Gaussian prior."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.compiled import compiled

Array = NDArray[np.float32]


@compiled
def drawn(noise: Array, basis: Array) -> Array:
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
