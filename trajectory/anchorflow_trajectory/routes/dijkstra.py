"""Cheapest ways over the cells of a grid: Dijkstra's algorithm with a queue of lists.

A step costs its length in cells times one plus the mean surcharge of its two cells; on ground
without surcharge, costs are lengths. No step costs less than one, so the queue has a list for each
whole cost, and the cells of a list are final when its turn comes (Dial, "Shortest-path forest with
topological ordering", Communications of the ACM 12, 1969; Denardo & Fox, "Shortest-route methods",
Operations Research 27, 1979). Among ways of equal cost the first found stays.

A search runs in a sheet, whose ways may come out of other sheets. A link says how a cell was
reached: eight times the sheet that the step left, plus the step's place in STEPS.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part

Steps = NDArray[np.uint8]
Cells = NDArray[np.int64]
Links = NDArray[np.int32]
Lengths = NDArray[np.float64]
Keys = NDArray[np.uint64]

ROUNDING = 1e-6  # cells by which two sums of the same steps may differ
NO_LINK = -1

# (rows, columns) of a step to each of the eight neighbours, and its length in cells. The reverse
# step has the mirrored index.
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


class Ground(NamedTuple):
    """The steps of a search, what they cost, and the bounds that prune it.

    steps: [H * W] of each cell; offsets: [8] of the flat cells that they lead to
    surcharge: [H * W] >= 0, cells of detour that one cell of way through a cell is worth
    rest: [H * W] lower bound of the way to the end; limit: of a whole way
    """

    steps: Steps
    offsets: Cells
    surcharge: Lengths
    rest: Lengths
    limit: float


@compiled_part
def step_cost(surcharge: Lengths, cell: int, head: int, step: int) -> float:
    """Cost in cells of a step from a cell to its neighbour."""
    return LENGTHS[step] * (1.0 + 0.5 * (surcharge[cell] + surcharge[head]))


class Ways(NamedTuple):
    """The cheapest ways to each cell in S sheets: their costs and last links, [S, H * W]."""

    lengths: Lengths
    links: Links


class Queue(NamedTuple):
    """The cells that wait, in a linked list for each whole cost that can be next.

    first, last: [L] the ends of each list, -1 if it is empty; L is a power of two
    cells, after: [9 * H * W] the cell of an entry, and the next entry of its list
    turns: [H * W] the whole cost at which each cell has its turn, if it waits
    reached: [H * W] the cells that had their turn, in this order
    """

    first: Links
    last: Links
    cells: Links
    after: Links
    turns: Links
    reached: Cells


class Entries(NamedTuple):
    """Where sheets may be entered, [E]: the sheet's key, a cell, the length until there, a link."""

    keys: Keys
    cells: Cells
    lengths: Lengths
    links: Links


@compiled_part
def new_queue(surcharge: Lengths) -> Queue:
    """Make an empty queue for a grid of cells with this surcharge [H * W]."""
    cells, lists = len(surcharge), 1
    while lists < LENGTHS.max() * (1.0 + surcharge.max()) + 2.0:
        lists *= 2
    return Queue(
        np.full(lists, -1, np.int32),
        np.full(lists, -1, np.int32),
        np.empty((len(STEPS) + 1) * cells, np.int32),
        np.empty((len(STEPS) + 1) * cells, np.int32),
        np.empty(cells, np.int32),
        np.empty(cells, np.int64),
    )


@compiled_part
def ways_from(cell: int, ground: Ground, queue: Queue) -> tuple[Ways, Cells]:
    """The ways from a cell, in one sheet, and the cells that they lead to, the nearest first."""
    lengths = np.full((1, len(ground.steps)), np.inf)
    ways = Ways(lengths, np.empty(lengths.shape, np.int32))
    return ways, spread(only_entry(cell), ground, queue, 0, ways)


@compiled_part
def spread(entries: Entries, ground: Ground, queue: Queue, sheet: int, ways: Ways) -> Cells:
    """Search a sheet from its entries, and change its ways.

    Returns the cells that are now reached for less, the nearest first but for parts of a cell.
    """
    steps, offsets, surcharge, rest, limit = ground
    first, last, cells, after, turns, reached = queue
    lengths, links = ways.lengths[sheet], ways.links[sheet]
    order = _in_order(entries.lengths)
    turns[:] = -1
    turn, entered, found, used, taken = 0, 0, 0, 0, 0
    while entered < len(order) or taken < used:
        if taken == used:
            turn = int(entries.lengths[order[entered]])
        entered, used = _enter(entries, order, entered, turn, queue, used, lengths, links)
        place = turn & (len(first) - 1)
        while first[place] >= 0:
            cell = cells[first[place]]
            first[place] = after[first[place]]
            taken += 1
            if turns[cell] != turn:
                continue
            reached[found] = cell
            found += 1
            so_far, price = lengths[cell], 1.0 + 0.5 * surcharge[cell]
            for k in range(len(STEPS)):
                if not (steps[cell] >> k) & 1:
                    continue
                head = cell + offsets[k]
                length = so_far + LENGTHS[k] * (price + 0.5 * surcharge[head])
                if length >= lengths[head] - ROUNDING or length + rest[head] > limit:
                    continue
                lengths[head], links[head], later = length, len(STEPS) * sheet + k, int(length)
                # Who stands on a later list has the turn of this one.
                if turns[head] == later:
                    continue
                # Written out: a call with so many arrays would take longer.
                turns[head], cells[used], after[used] = later, head, -1
                end = last[later & (len(first) - 1)]
                if end >= 0:
                    after[end] = used
                else:
                    first[later & (len(first) - 1)] = used
                last[later & (len(first) - 1)] = used
                used += 1
        last[place] = -1
        turn += 1
    return reached[:found].copy()


@compiled_part
def _in_order(lengths: Lengths) -> Cells:
    """The places of lengths [E], the shortest first and of equal ones the first.

    A merge sort, which compiles in a third of the time of numpy's.
    """
    count, run = len(lengths), 1
    order, merged = np.arange(count), np.empty(count, np.int64)
    while run < count:
        for begin in range(0, count, 2 * run):
            left, right, end = begin, min(begin + run, count), min(begin + 2 * run, count)
            middle = right
            for place in range(begin, end):
                is_left = left < middle
                if is_left and right < end:
                    is_left = lengths[order[left]] <= lengths[order[right]]
                if is_left:
                    merged[place] = order[left]
                    left += 1
                else:
                    merged[place] = order[right]
                    right += 1
        order, merged = merged, order
        run *= 2
    return order


@compiled_part
def _enter(
    entries: Entries,
    order: Cells,
    entered: int,
    turn: int,
    queue: Queue,
    used: int,
    lengths: Lengths,
    links: Links,
) -> tuple[int, int]:
    """Put the entries that have this turn on its list.

    Returns how many of all [E] had theirs, and how many entries of the queue are used.
    """
    place = turn & (len(queue.first) - 1)
    while entered < len(order) and entries.lengths[order[entered]] < turn + 1:
        entry = order[entered]
        cell, length = entries.cells[entry], entries.lengths[entry]
        entered += 1
        if length >= lengths[cell] - ROUNDING:
            continue
        lengths[cell], links[cell] = length, entries.links[entry]
        if queue.turns[cell] == turn:
            continue
        queue.turns[cell], queue.cells[used], queue.after[used] = turn, cell, -1
        if queue.last[place] >= 0:
            queue.after[queue.last[place]] = used
        else:
            queue.first[place] = used
        queue.last[place] = used
        used += 1
    return entered, used


@compiled_part
def only_entry(cell: int) -> Entries:
    """Where ways begin."""
    one = np.full(1, NO_LINK, np.int32)
    return Entries(np.zeros(1, np.uint64), np.full(1, cell), np.zeros(1), one)


@compiled_part
def walked_back(cell: int, link: int, links: Links, ground: Ground) -> Cells:
    """The cells from one to where its way began, by the links [S, H * W] of all sheets."""
    way, count = np.empty(int(ground.limit) + 2, np.int64), 1
    way[0] = cell
    while link != NO_LINK:
        sheet, step = divmod(link, len(STEPS))
        cell -= ground.offsets[step]
        way[count] = cell
        count += 1
        link = links[sheet, cell]
    return way[:count]
