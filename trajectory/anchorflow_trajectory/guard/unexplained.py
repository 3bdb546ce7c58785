"""What of an occupancy by time no box explains: objects whose motion is not found."""

from __future__ import annotations

import numpy as np

from anchorflow_trajectory.compiled import compiled, compiled_part

ERASED = 0.75
"""Cells beyond a box of whose cells it is taken for the cause."""
JOINED = 128
"""Cells that empty, or fill, from one layer to the next and are joined, at most."""


@compiled
def leave_rest(rest, boxes, frame, fastest):
    """Write 0 to the cells of boxes, then 1 to those between cells that empty and cells that fill.

    rest: [L,H,W] 1 where something is, else 0; boxes: [K,8] as `Perceived` has them
    frame: of a `Raster`; fastest: m/s at which anything moves at most
    """
    for layer in range(len(rest)):
        for k in range(len(boxes)):
            _erase(rest[layer], boxes[k], frame, frame[3] + layer * frame[4])
    most = fastest * frame[4] / frame[2]
    gone, come = np.empty((JOINED, 2), np.int64), np.empty((JOINED, 2), np.int64)
    for layer in range(len(rest) - 1):
        many = _only(rest[layer], rest[layer + 1], gone)
        _join(rest[layer], gone[:many], come[: _only(rest[layer + 1], rest[layer], come)], most)


@compiled_part
def _only(one, other, cells):
    """Write the cells [·,2] of one layer about which the other has none; return how many."""
    rows, columns = one.shape
    count = 0
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            if one[row, column] == 1.0 and other[row, column] == 0.0 and count < len(cells):
                about = 0.0
                for i in range(row - 1, row + 2):
                    for j in range(column - 1, column + 2):
                        about += other[i, j]
                if about == 0.0:
                    cells[count, 0], cells[count, 1] = row, column
                    count += 1
    return count


@compiled_part
def _join(layer, gone, come, most):
    """Write 1 to the cells on the way from each cell to each other one, at most so far off."""
    for a in range(len(gone)):
        for b in range(len(come)):
            down, right = come[b, 0] - gone[a, 0], come[b, 1] - gone[a, 1]
            if down * down + right * right <= most * most:
                pieces = max(abs(down), abs(right))
                for k in range(1, pieces):
                    i = int(gone[a, 0] + down * k / pieces + 0.5)
                    layer[i, int(gone[a, 1] + right * k / pieces + 0.5)] = 1.0


@compiled_part
def _erase(rest, box, frame, time):
    """Write 0 to the cells that a box touches at a time."""
    x, y, cell = box[0] + time * box[5], box[1] + time * box[6], frame[2]
    cos, sin = np.cos(box[2]), np.sin(box[2])
    reach = (box[3] + box[4]) / cell + 1.0
    row, column = (frame[0] - x) / cell - 0.5, (frame[1] - y) / cell - 0.5
    for i in range(max(int(row - reach), 0), min(int(row + reach) + 2, rest.shape[0])):
        for j in range(max(int(column - reach), 0), min(int(column + reach) + 2, rest.shape[1])):
            dx, dy = cell * (row - i), cell * (column - j)
            ahead, aside = abs(dx * cos + dy * sin), abs(dy * cos - dx * sin)
            if ahead <= box[3] + ERASED * cell and aside <= box[4] + ERASED * cell:
                rest[i, j] = 0.0
