"""The cells of a map and the steps between them, on which routes are searched.

A cell is told by its flat index. The steps from a cell are eight bits, one for each of STEPS.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.compiled import compiled

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]
Steps = NDArray[np.uint8]

# (rows, columns) of a step to each of the eight neighbours, and its length in cells. The step back
# stands in the mirrored place.
STEPS = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c])
LENGTHS = np.hypot(*STEPS.T)


def cell_index(
    point: FloatArray, origin: FloatArray, cell_size: float, shape: tuple[int, int]
) -> int:
    """Flat index of the cell that holds a point [2] in m, clamped to the map."""
    column, row = ((np.asarray(point[:2]) - origin) / cell_size).astype(int)
    return int(np.clip(row, 0, shape[0] - 1) * shape[1] + np.clip(column, 0, shape[1] - 1))


@compiled
def free_steps(free: BoolArray) -> Steps:
    """[H * W], the steps between free cells [H, W] that cut no corner."""
    height, width = free.shape
    steps = np.zeros(height * width, np.uint8)
    for row in range(height):
        for column in range(width):
            if not free[row, column]:
                continue
            for k in range(len(STEPS)):
                to_row, to_column = row + STEPS[k, 0], column + STEPS[k, 1]
                if (
                    0 <= to_row < height
                    and 0 <= to_column < width
                    and free[to_row, to_column]
                    and free[row, to_column]
                    and free[to_row, column]
                ):
                    steps[row * width + column] |= np.uint8(1 << k)
    return steps
