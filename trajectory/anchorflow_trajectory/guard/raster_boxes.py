"""Boxes and their velocities, read from rasters of occupancy at constant velocity.

A patch of cells that touch is one or several objects. Its velocities are all those that take it
onto later layers: one for an object that stands alone, several where it may be taken for another,
so that none is missed. A patch that is not a rectangle is told as its cells, and one whose motion
is not found by the cells of every layer and those between.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.unexplained import leave_rest

LAYERS = 4
"""Layers that are compared, now the first."""
SMALL = 8.0
"""Cells of a patch that may be a person, who moves anywhere at up to 3 cells a layer."""
BESIDE = 0.55
"""Cells beyond a box, with its margin, at which the middles of its own cells may lie."""
PATCHES, CELLS = 256, 8192  # at most, in a layer
MOST_BOXES = 4096
SAME = 0.02
"""Share of a cell that may change of what stands: what moves by 1 cm/s is seen to, in 1.5 s."""
LEAST = 0.02
"""Share of a cell from which on it belongs to a patch."""
FASTEST = 45.0
"""m/s."""
MARGIN = 0.1
"""m that is added to a box's half sizes, which shares tell to a few centimetres."""
FITTING = 0.2
"""Share by which the area of a patch may differ from that of its rectangle."""
SUPPORT, OF_CELLS = 0.8, 0.35
"""Share of a patch that a later layer has to show where its velocity takes it, and of each cell."""


def boxes_in(occupied: Raster) -> tuple[FloatArray, Raster]:
    """Return boxes [K,8] as `Perceived` has them, and what of the occupancy is not in them.

    occupied: layers of boxes at constant velocity, the first of which is now
    """
    layers = np.ascontiguousarray(occupied.values[:LAYERS], np.float32)
    boxes = np.empty((MOST_BOXES, 8))
    boxes = boxes[: _boxes_in(layers, occupied.frame, boxes)]
    rest = (layers >= LEAST).astype(np.float32)
    leave_rest(rest, boxes, occupied.frame, FASTEST)
    return boxes, replace(occupied, values=rest)


@compiled
def _boxes_in(layers, frame, boxes):
    """Write the boxes; return their number."""
    count = layers.shape[0]
    cells = np.empty((count, CELLS, 2), np.int32)
    ends = np.zeros((count, PATCHES), np.int64)
    patches = np.zeros((count, PATCHES, 3))
    found = np.zeros(count, np.int64)
    for layer in range(count):
        found[layer] = _patches(layers[layer], cells[layer], ends[layer], patches[layer])
    total, shifts, box = 0, np.empty((PATCHES, 2)), np.empty(5)
    for patch in range(found[0]):
        own = cells[0, (ends[0, patch - 1] if patch else 0) : ends[0, patch]]
        is_box = _fits(layers[0], own, patches[0, patch], frame, box)
        several = _shifts(layers, own, patches, found, patch, frame, shifts)
        if several == 0:
            several = _searched(layers, own, patches[0, patch, 0], box[2], is_box, shifts)
        for k in range(several):
            total = _told(own, box, is_box, shifts[k], frame, boxes, total)
    return total


@compiled_part
def _patches(layer, cells, ends, patches):
    """Find patches of touching cells; return their number.

    cells: [CELLS,2] row and column, patch after patch; ends: [PATCHES] of each in them
    patches: [PATCHES,3] area in cells, mean row, mean column
    """
    rows, columns = layer.shape
    seen = np.zeros((rows, columns), np.bool_)
    found, filled = 0, 0
    for row in range(rows):
        for column in range(columns):
            if seen[row, column] or layer[row, column] < LEAST:
                continue
            if found == PATCHES or filled == CELLS:
                return found
            begin = filled
            cells[filled, 0], cells[filled, 1] = row, column
            filled += 1
            seen[row, column] = True
            at = begin
            while at < filled:
                r, c = cells[at, 0], cells[at, 1]
                at += 1
                for i in range(max(r - 1, 0), min(r + 2, rows)):
                    for j in range(max(c - 1, 0), min(c + 2, columns)):
                        if not seen[i, j] and layer[i, j] >= LEAST and filled < CELLS:
                            seen[i, j] = True
                            cells[filled, 0], cells[filled, 1] = i, j
                            filled += 1
            area, r_sum, c_sum = 0.0, 0.0, 0.0
            for k in range(begin, filled):
                share = layer[cells[k, 0], cells[k, 1]]
                area += share
                r_sum += share * cells[k, 0]
                c_sum += share * cells[k, 1]
            patches[found, 0] = area
            patches[found, 1], patches[found, 2] = r_sum / area, c_sum / area
            ends[found] = filled
            found += 1
    return found


@compiled_part
def _shifts(layers, own, patches, found, patch, frame, shifts):
    """Write the shifts [·,2] in cells a layer that take a patch onto patches of about its area in
    later layers, and onto what all layers show; return how many.
    """
    area, r, c = patches[0, patch, 0], patches[0, patch, 1], patches[0, patch, 2]
    most = FASTEST * frame[4] / frame[2]
    count = 0
    if _stands(layers, own):
        shifts[0, 0] = shifts[0, 1] = 0.0
        return 1
    for layer in range(1, layers.shape[0]):
        for other in range(found[layer]):
            if abs(patches[layer, other, 0] - area) > 0.15 * area + 0.3:
                continue
            dr, dc = (patches[layer, other, 1] - r) / layer, (patches[layer, other, 2] - c) / layer
            if dr * dr + dc * dc > most * most or count == PATCHES:
                continue
            known = False
            for k in range(count):
                if abs(shifts[k, 0] - dr) + abs(shifts[k, 1] - dc) < 0.1:
                    known = True
            if not known and _is_supported(layers, own, dr, dc):
                shifts[count, 0], shifts[count, 1] = dr, dc
                count += 1
    return count


@compiled_part
def _searched(layers, own, area, heading, is_box, shifts):
    """Write the shifts that take a patch onto what all layers show; return how many.

    Of a small one those in all directions, of a box those along its heading.
    """
    count = 0
    if not is_box:
        return count
    tries = 13 * 13 if area < SMALL else 401
    for k in range(tries):
        if area < SMALL:
            dr, dc = 0.5 * (k // 13 - 6), 0.5 * (k % 13 - 6)
        else:
            dr, dc = -0.2 * (k - 200) * np.cos(heading), -0.2 * (k - 200) * np.sin(heading)
        if count < PATCHES and _is_supported(layers, own, dr, dc):
            shifts[count, 0], shifts[count, 1] = dr, dc
            count += 1
    return count


@compiled_part
def _stands(layers, own):
    """Whether all layers show a patch as the first does."""
    for layer in range(1, layers.shape[0]):
        for k in range(len(own)):
            row, column = own[k, 0], own[k, 1]
            if abs(layers[layer, row, column] - layers[0, row, column]) > SAME:
                return False
    return True


@compiled_part
def _is_supported(layers, own, dr, dc):
    """Whether all later layers show a patch where a shift takes it, as far as they reach."""
    rows, columns = layers.shape[1:]
    for layer in range(1, layers.shape[0]):
        asked, shown = 0.0, 0.0
        for k in range(len(own)):
            row, column = own[k, 0] + layer * dr, own[k, 1] + layer * dc
            if row < 0 or column < 0 or row >= rows - 1 or column >= columns - 1:
                continue
            i, j = int(row), int(column)
            y, x = row - i, column - j
            share = layers[0, own[k, 0], own[k, 1]]
            upper = (1 - x) * layers[layer, i, j] + x * layers[layer, i, j + 1]
            lower = (1 - x) * layers[layer, i + 1, j] + x * layers[layer, i + 1, j + 1]
            value = (1 - y) * upper + y * lower
            if value < OF_CELLS * share - 0.1:
                return False
            asked += share
            shown += min(share, value)
        if shown < SUPPORT * asked - 0.3:
            return False
    return True


@compiled_part
def _fits(layer, own, patch, frame, box):
    """Write the rectangle of a patch to [5] x, y, heading, half length, half width; return whether
    it is the patch."""
    area, r, c = patch[0], patch[1], patch[2]
    rr, cc, rc = 0.0, 0.0, 0.0
    for k in range(len(own)):
        share, y, x = layer[own[k, 0], own[k, 1]], own[k, 0] - r, own[k, 1] - c
        rr += share * y * y
        cc += share * x * x
        rc += share * x * y
    # Cells spread what they hold: Sheppard's correction of the variance, in cells.
    rr, cc, rc = rr / area - 1 / 12, cc / area - 1 / 12, rc / area
    mean, apart = (rr + cc) / 2, np.hypot((rr - cc) / 2, rc)
    length, width = np.sqrt(12 * max(mean + apart, 0.0)), np.sqrt(12 * max(mean - apart, 0.0))
    cell = frame[2]
    box[0], box[1] = frame[0] - cell * (r + 0.5), frame[1] - cell * (c + 0.5)
    # x falls with rows and y with columns, so both turn over and the angle stays.
    box[2] = 0.5 * np.arctan2(2 * rc, rr - cc)
    box[3], box[4] = cell * length / 2 + MARGIN, cell * width / 2 + MARGIN
    if abs(length * width - area) > FITTING * area + 0.5:
        return False
    cos, sin = np.cos(box[2]), np.sin(box[2])
    for k in range(len(own)):
        dx, dy = cell * (r - own[k, 0]), cell * (c - own[k, 1])
        beyond = abs(dx * cos + dy * sin) > box[3] + BESIDE * cell
        if beyond or abs(dy * cos - dx * sin) > box[4] + BESIDE * cell:
            return False
    return True


@compiled_part
def _told(own, box, is_box, shift, frame, boxes, total):
    """Write a patch that moves by a shift as its rectangle or as its cells; return the new total.

    Number by number, as numba compiles that in a third of the time.
    """
    cell = frame[2]
    for k in range(1 if is_box else len(own)):
        if total == len(boxes):
            return total
        if is_box:
            for i in range(5):
                boxes[total, i] = box[i]
        else:
            boxes[total, 0] = frame[0] - cell * (own[k, 0] + 0.5)
            boxes[total, 1] = frame[1] - cell * (own[k, 1] + 0.5)
            boxes[total, 2] = 0.0
            boxes[total, 3] = boxes[total, 4] = cell / 2
        boxes[total, 5] = -shift[0] * cell / frame[4]
        boxes[total, 6] = -shift[1] * cell / frame[4]
        boxes[total, 7] = 0.0
        total += 1
    return total
