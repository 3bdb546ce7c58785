"""Shortest ways over the cells of a grid: Dijkstra's algorithm with a queue of lists.

Lengths are in cells. No step is shorter than one, so the queue has a list for each whole length,
and the cells of a list are final when its turn comes (Dial, "Shortest-path forest with topological
ordering", Communications of the ACM 12, 1969; Denardo & Fox, "Shortest-route methods",
Operations Research 27, 1979). Among ways of equal length the first found stays.

A search runs in a sheet, whose ways may come out of other sheets. A link says how a cell was
reached: eight times the sheet that the step left, plus the step's place in STEPS.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled

Steps = NDArray[np.uint8]
Cells = NDArray[np.int64]
Links = NDArray[np.int32]
Lengths = NDArray[np.float64]
Keys = NDArray[np.uint64]

ROUNDING = 1e-6  # cells by which two sums of the same steps may differ
NO_LINK = -1
LISTS = 3  # a step leads one or two lists on

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
    """The steps of a search, and the bounds that prune it.

    steps: [H * W] of each cell; offsets: [8] of the flat cells that they lead to
    rest: [H * W] lower bound of the way to the end; limit: of a whole way
    """

    steps: Steps
    offsets: Cells
    rest: Lengths
    limit: float


class Ways(NamedTuple):
    """The shortest ways to each cell in S sheets: their lengths and last links, [S, H * W]."""

    lengths: Lengths
    links: Links


class Queue(NamedTuple):
    """The cells that wait for their turn, the whole length of their way.

    lists: [LISTS, H * W], of the turns that are next; counts: [LISTS] of cells on them
    turns: [H * W] when each cell has its turn, if it has one
    reached: [H * W] those that had theirs, in this order
    """

    lists: NDArray[np.int32]
    counts: Cells
    turns: NDArray[np.int32]
    reached: Cells


class Entries(NamedTuple):
    """Where sheets may be entered, [E]: the sheet's key, a cell, the length until there, a link."""

    keys: Keys
    cells: Cells
    lengths: Lengths
    links: Links


@compiled
def new_queue(cells: int) -> Queue:
    """Make an empty queue for a grid of `cells` cells."""
    return Queue(
        np.empty((LISTS, cells), np.int32),
        np.zeros(LISTS, np.int64),
        np.empty(cells, np.int32),
        np.empty(cells, np.int64),
    )


@compiled
def ways_from(cell: int, ground: Ground, queue: Queue) -> tuple[Ways, Cells]:
    """The ways from a cell, in one sheet, and the cells that they lead to, the nearest first."""
    lengths = np.full((1, len(ground.steps)), np.inf)
    ways = Ways(lengths, np.empty(lengths.shape, np.int32))
    return ways, spread(only_entry(cell), ground, queue, 0, ways)


@compiled
def spread(entries: Entries, ground: Ground, queue: Queue, sheet: int, ways: Ways) -> Cells:
    """Search a sheet from its entries, and change its ways.

    Returns the cells that are now reached in less, the nearest first but for parts of a cell.
    """
    steps, offsets, rest, limit = ground
    lists, counts, turns, reached = queue
    lengths, links = ways.lengths[sheet], ways.links[sheet]
    order = np.argsort(entries.lengths, kind="mergesort")
    turns[:] = -1
    turn, entered, found = 0, 0, 0
    while entered < len(order) or counts.any():
        if not counts.any():
            turn = int(entries.lengths[order[entered]])
        entered = _enter(entries, order, entered, turn, queue, lengths, links)
        for place in range(counts[turn % LISTS]):
            cell = lists[turn % LISTS, place]
            if turns[cell] != turn:
                continue
            reached[found] = cell
            found += 1
            for k in range(len(STEPS)):
                if not (steps[cell] >> k) & 1:
                    continue
                head, length = cell + offsets[k], lengths[cell] + LENGTHS[k]
                if length >= lengths[head] - ROUNDING or length + rest[head] > limit:
                    continue
                lengths[head], links[head], later = length, len(STEPS) * sheet + k, int(length)
                # Who stood on a later list has the turn of this one.
                if turns[head] != later:
                    turns[head], lists[later % LISTS, counts[later % LISTS]] = later, head
                    counts[later % LISTS] += 1
        counts[turn % LISTS] = 0
        turn += 1
    return reached[:found].copy()


@compiled
def _enter(
    entries: Entries,
    order: Cells,
    entered: int,
    turn: int,
    queue: Queue,
    lengths: Lengths,
    links: Links,
) -> int:
    """Put the entries that have this turn on its list; returns how many of all [E] had theirs."""
    current = turn % LISTS
    while entered < len(order) and entries.lengths[order[entered]] < turn + 1:
        entry = order[entered]
        cell, length = entries.cells[entry], entries.lengths[entry]
        entered += 1
        if length < lengths[cell] - ROUNDING:
            lengths[cell], links[cell] = length, entries.links[entry]
            if queue.turns[cell] != turn:
                queue.turns[cell], queue.lists[current, queue.counts[current]] = turn, cell
                queue.counts[current] += 1
    return entered


@compiled
def only_entry(cell: int) -> Entries:
    """Where ways begin."""
    one = np.full(1, NO_LINK, np.int32)
    return Entries(np.zeros(1, np.uint64), np.full(1, cell), np.zeros(1), one)


@compiled
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
