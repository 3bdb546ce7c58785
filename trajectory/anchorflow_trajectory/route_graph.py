"""The steps between free cells of a grid, on which routes are searched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]
Cells = NDArray[np.int32]

# (rows, columns) of a step to each of the eight neighbours, and its length in cells.
STEPS = tuple((r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c)
LENGTHS = np.hypot(*np.array(STEPS).T)


@dataclass(frozen=True, eq=False)
class Moves:
    """E steps between neighbouring cells out of n, sorted by tail.

    ends: [n + 1] where the steps from each cell begin and end
    tails, heads: [E] cells; lengths: [E] in cells; across: [E] columns gone to the right
    """

    ends: Cells
    tails: Cells
    heads: Cells
    lengths: NDArray[np.float64]
    across: NDArray[np.int32]

    @staticmethod
    def where(allowed: BoolArray) -> Moves:
        """Those that [H, W, 8] allows, none of which leaves the grid, between its flat cells."""
        height, width, count = allowed.shape
        flat = np.flatnonzero(allowed).astype(np.int32)
        tails, steps = flat // count, flat % count
        offsets = np.array([row * width + column for row, column in STEPS], np.int32)
        across = np.array([column for _, column in STEPS], np.int32)
        return Moves(
            _ends(tails, height * width),
            tails,
            tails + offsets[steps],
            LENGTHS[steps],
            across[steps],
        )

    def among(self, cells: Cells) -> Moves:
        """Those between some of the cells [n'], which are numbered anew in their order."""
        numbers = np.full(len(self.ends) - 1, -1, np.int32)
        numbers[cells] = np.arange(len(cells), dtype=np.int32)
        tails, heads = numbers[self.tails], numbers[self.heads]
        kept = np.flatnonzero((tails >= 0) & (heads >= 0))
        tails = tails[kept]
        return Moves(
            _ends(tails, len(cells)), tails, heads[kept], self.lengths[kept], self.across[kept]
        )

    def graph(self, weights: FloatArray) -> csr_array:
        """As a directed graph, weighted by [E]."""
        nodes = len(self.ends) - 1
        return csr_array((weights, self.heads, self.ends), shape=(nodes, nodes))


def _ends(tails: Cells, cells: int) -> Cells:
    ends = np.zeros(cells + 1, np.int32)
    np.cumsum(np.bincount(tails, minlength=cells), out=ends[1:])
    return ends


def neighbours(values: NDArray, *, outside: float | bool) -> NDArray:
    """[H, W, 8]: what stands at each cell's neighbours, in the order of STEPS."""
    height, width = values.shape
    padded = np.pad(values, 1, constant_values=outside)
    found = np.empty((height, width, len(STEPS)), values.dtype)
    for k, (row, column) in enumerate(STEPS):
        found[..., k] = padded[1 + row : 1 + row + height, 1 + column : 1 + column + width]
    return found


def free_steps(free: BoolArray) -> BoolArray:
    """[H, W, 8], the steps between free cells [H, W] that cut no corner."""
    near = neighbours(free, outside=False)
    allowed = near & free[..., None]
    for k, (row, column) in enumerate(STEPS):
        if row and column:
            allowed[..., k] &= (
                near[..., STEPS.index((row, 0))] & near[..., STEPS.index((0, column))]
            )
    return allowed


def summed_onward(onward: Cells, steps: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """What the steps of each cell's way are worth together, modulo 2^64: [n].

    onward: [n] the next cell on the way, the cell itself at its end; steps: [n] what the step to it
    is worth, 0 at the end
    """
    total, jump = steps, onward
    # Every total covers a stretch of the way, and a jump leads to where the next one begins.
    while (jump[jump] != jump).any():
        total, jump = total + total[jump], jump[jump]
    return total + total[jump]
