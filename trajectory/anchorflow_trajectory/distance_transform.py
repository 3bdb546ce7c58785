"""The nearest set cell of every cell of a grid, exactly.

Felzenszwalb & Huttenlocher, "Distance transforms of sampled functions", Theory of Computing 8,
2012: first along the columns, then along each row as the lower envelope of parabolas. The squares
of the distances are integers, so that nothing is rounded.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.compiled import compiled

BoolArray = NDArray[np.bool_]


@compiled
def distance_in_cells(cells: BoolArray) -> NDArray[np.float64]:
    """Distance [H, W] from every cell's centre to the *square* of the nearest set cell.

    The nearest by its centre; of several the one with the least row of its column, and of those the
    first by column. Infinite where no cell is set.
    """
    height, width = cells.shape
    apart = _along_columns(cells)
    distance = np.full((height, width), np.inf)
    # The envelope's parabolas: the column of each one's tip, and the first at which it is lowest.
    tips, begins = np.empty(width, np.int64), np.empty(width, np.int64)
    for row in range(height):
        count = 0
        for column in range(width):
            if apart[row, column] < 0:
                continue
            begin = 0
            while count:
                tip = tips[count - 1]
                rise = apart[row, column] ** 2 - apart[row, tip] ** 2 + column**2 - tip**2
                # Where both are as low, the left one stays.
                begin = rise // (2 * (column - tip)) + 1
                if begin > begins[count - 1]:
                    break
                count, begin = count - 1, 0
            if begin < width:
                tips[count], begins[count] = column, begin
                count += 1
        if not count:
            continue
        at = 0
        for column in range(width):
            while at + 1 < count and begins[at + 1] <= column:
                at += 1
            down = max(apart[row, tips[at]] - 0.5, 0.0)
            across = max(abs(column - tips[at]) - 0.5, 0.0)
            distance[row, column] = np.sqrt(down * down + across * across)
    return distance


@compiled
def _along_columns(cells: BoolArray) -> NDArray[np.int64]:
    """Cells [H, W] to the nearest set cell of the same column; -1 where it has none."""
    height, width = cells.shape
    apart = np.full((height, width), -1, np.int64)
    for row in range(height):
        for column in range(width):
            if cells[row, column]:
                apart[row, column] = 0
            elif row and apart[row - 1, column] >= 0:
                apart[row, column] = apart[row - 1, column] + 1
    for row in range(height - 2, -1, -1):
        for column in range(width):
            below = apart[row + 1, column]
            if below >= 0 and (apart[row, column] < 0 or below + 1 < apart[row, column]):
                apart[row, column] = below + 1
    return apart
