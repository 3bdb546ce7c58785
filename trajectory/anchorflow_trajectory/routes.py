"""The shortest routes of a scene, one for each way round its obstacles.

A route is the shortest path on the grid among those with its signature (`ray_signature`). They are
searched best first over pairs of cell and signature (Bhattacharya, Likhachev & Kumar, "Topological
constraints in search-based robot path planning", Autonomous Robots 33, 2012), with the distance to
the goal as the heuristic, which is exact, and with the pairs gathered into sheets:

    A pair's sheet is the signature of the whole route if the goal is then reached by the shortest
    way. All steps stay in their sheet but those across the cuts, where neighbouring cells take ways
    to the goal on two sides of an obstacle. So the cheapest entry into a sheet is the length of its
    route, there are no more sheets to search than routes to find, and each is one run of Dijkstra's
    algorithm, which scipy does, on the cells that lie on ways short enough.

A pair's excess is the length of the shortest route through it, less that of the shortest route.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from anchorflow_trajectory.geodesic import cell_index
from anchorflow_trajectory.ray_signature import ObstacleRays, Signature
from anchorflow_trajectory.route_graph import Moves, free_steps, summed_onward

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

MOST = 12
STRETCH = 1.3
SLACK = 0.02  # m beyond robot_radius that a route keeps, so that a spline along it can
ROUNDING = 1e-6  # cells by which two sums of the same steps may differ


@dataclass(frozen=True, eq=False)
class Route:
    """A way from start to goal.

    points: [K, 2] m, in the map's frame, from the start to the goal
    length: m, of the polyline through them
    signature: crossings of the ray of each obstacle, as `ObstacleRays` orders them
    """

    points: NDArray[np.float64]
    length: float
    signature: Signature


def find_routes(
    clearance: FloatArray,
    *,
    resolution: float,
    origin: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    most: int = MOST,
    stretch: float = STRETCH,
    slack: float = SLACK,
    rays: ObstacleRays | None = None,
) -> list[Route]:
    """The shortest routes on the grid with different signatures, the shortest first.

    Empty where no way is free. The same arguments bring the same routes.

    Args:
        clearance: [H, W] m beyond robot_radius at cell centres, negative where the robot would
            touch something.
        resolution: m/cell.
        origin: [2] m, outer corner of cell (0, 0).
        start, goal: [2] m. Cells about them are free with less than `slack`, their own with any
            clearance: who stands close to something may leave.
        most: routes at most.
        stretch: times the shortest that a route may be long.
        slack: m of clearance that routes keep.
        rays: of this clearance, where they are known already.

    Raises:
        ValueError: `most` is below 1, `stretch` below 1 or `slack` negative.
    """
    if most < 1 or not stretch >= 1.0 or not slack >= 0.0:
        raise ValueError(
            f"expected most >= 1, stretch >= 1 and slack >= 0, got {most}, {stretch} and {slack}"
        )
    height, width = clearance.shape
    ends = [cell_index(end, origin, resolution, (height, width)) for end in (start, goal)]
    near = NearWays.of(free_cells(clearance, ends, slack=slack), ends, stretch=stretch)
    if near is None:
        return []
    rays, routes = rays or ObstacleRays.of(clearance), []
    for cells in Sheets.of(near, rays).routes(most):
        rows, columns = np.divmod(np.array(cells[1:-1], int), width)
        inner = (np.stack([columns, rows], -1) + 0.5) * resolution + origin
        points = np.concatenate([[start], inner, [goal]]).astype(np.float64)
        length = polyline_length(points)
        (signature,) = rays.signatures(points[None], resolution=resolution, origin=origin)
        routes.append(Route(points, length, signature))
    return sorted(routes, key=lambda route: route.length)


def polyline_length(points: FloatArray) -> float:
    """m, through points [K, 2]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def free_cells(clearance: FloatArray, ends: Sequence[int], *, slack: float) -> BoolArray:
    """[H, W], the cells that routes may take between two flat cells."""
    free = clearance >= slack
    for row, column in (divmod(end, clearance.shape[1]) for end in ends):
        about = (slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2))
        free[about] |= clearance[about] >= 0.0
        free[row, column] = True
    return free


@dataclass(frozen=True, eq=False)
class NearWays:
    """The n cells that lie on ways from start to goal which are short enough, and their steps.

    cells: [n] flat cells of the map; start: which of them it is
    to_goal: [n] in cells; onward: [n] the next one on the shortest way, itself at the goal
    allowance: cells by which a way may be longer than the shortest
    """

    moves: Moves
    cells: NDArray[np.int32]
    start: int
    to_goal: NDArray[np.float64]
    onward: NDArray[np.int32]
    allowance: float

    @staticmethod
    def of(free: BoolArray, ends: Sequence[int], *, stretch: float) -> NearWays | None:
        """Of a grid [H, W] and the flat cells of start and goal; None where there is no way."""
        moves = Moves.where(free_steps(free))
        graph = moves.graph(moves.lengths)
        (from_start, to_goal), (_, onward) = dijkstra(
            graph, indices=list(ends), return_predecessors=True
        )
        shortest = to_goal[ends[0]]
        if not np.isfinite(shortest):
            return None
        allowance = (stretch - 1.0) * shortest + ROUNDING
        cells = np.flatnonzero(from_start + to_goal <= shortest + allowance).astype(np.int32)
        start, goal = np.searchsorted(cells, ends)
        onward = np.searchsorted(cells, onward[cells]).astype(np.int32)
        onward[goal] = goal
        return NearWays(
            moves.among(cells), cells, int(start), to_goal[cells], onward, float(allowance)
        )

    def onward_from(self, cell: int) -> list[int]:
        """The cells from this one to the goal."""
        way = [cell]
        while (onward := int(self.onward[cell])) != cell:
            way.append(cell := onward)
        return way

    def changes(self, rays: ObstacleRays) -> NDArray[np.uint64]:
        """[E], what each step adds to the key of the whole route's signature."""
        crossed = rays.keys_crossed().ravel()[self.cells]
        width = np.int32(rays.shape[1])
        across = self.cells[self.onward] % width - self.cells % width
        onward = _crossed(crossed, crossed[self.onward], across)
        rest = summed_onward(self.onward, onward)
        tails, heads = self.moves.tails, self.moves.heads
        step = _crossed(crossed[tails], crossed[heads], self.moves.across)
        return step + rest[heads] - rest[tails]


def _crossed(
    at_tail: NDArray[np.uint64], at_head: NDArray[np.uint64], across: NDArray[np.int32]
) -> NDArray[np.uint64]:
    """What steps add to a signature's key, from what a step to the right adds at either end."""
    return np.where(across > 0, at_tail, np.where(across < 0, -at_head, np.uint64(0)))


@dataclass(frozen=True)
class Entry:
    """Where a search may enter a sheet: at a cell, with an excess in cells, from another pair."""

    cell: int
    excess: float
    sheet: int | None = None
    tail: int = -1


@dataclass
class Sheet:
    """What is known of the pairs of one sheet: [n] excess, the cell before (n
    where the sheet is entered), and the entries by their cell."""

    excess: NDArray[np.float64]
    before: NDArray[np.int32]
    entries: dict[int, Entry] = field(default_factory=dict)

    @staticmethod
    def unknown(cells: int) -> Sheet:
        """Of which no pair is reached yet."""
        return Sheet(np.full(cells, np.inf), np.zeros(cells, np.int32))


@dataclass(frozen=True, eq=False)
class Sheets:
    """The pairs of cell and signature, sheet by sheet, on the n cells near the shortest way.

    inside: the steps that stay in their sheet, weighted by their excess
    tails, heads, excess: [Q] of the steps across the cuts; change: [Q] of the sheet's key
    """

    near: NearWays
    inside: csr_array
    tails: NDArray[np.int32]
    heads: NDArray[np.int32]
    excess: NDArray[np.float64]
    change: NDArray[np.uint64]

    @staticmethod
    def of(near: NearWays, rays: ObstacleRays) -> Sheets:
        """Cut where the rays tell ways to the goal apart."""
        moves, change = near.moves, near.changes(rays)
        excess = moves.lengths + near.to_goal[moves.heads] - near.to_goal[moves.tails]
        # Rounding must not make a step along the shortest way shorter than nothing.
        excess = np.maximum(excess, 0.0)
        cuts = np.flatnonzero(change)
        # What lies beyond the search's limit is never taken.
        inside = moves.graph(np.where(change == 0, excess, np.inf))
        return Sheets(
            near, inside, moves.tails[cuts], moves.heads[cuts], excess[cuts], change[cuts]
        )

    def routes(self, most: int) -> Iterator[list[int]]:
        """The cells of each route from start to goal, the shortest first."""
        known: dict[int, Sheet] = {}
        pending = {0: [Entry(self.near.start, 0.0)]}
        while pending and most:
            key = min(pending, key=lambda k: min(entry.excess for entry in pending[k]))
            entries = pending.pop(key)
            if key not in known:
                known[key] = Sheet.unknown(len(self.near.cells))
                yield self._cells(min(entries, key=lambda entry: entry.excess), known)
                most -= 1
            if most:
                improved = self._enter(known[key], entries)
                self._leave(key, known, improved, pending)

    def _enter(self, sheet: Sheet, entries: list[Entry]) -> BoolArray:
        """Search a sheet from its entries; returns which cells [n] it now reaches in less."""
        best: dict[int, Entry] = {}
        for entry in sorted(entries, key=lambda entry: -entry.excess):
            best[entry.cell] = entry
        nodes, graph = len(self.near.cells), self.inside
        # One more node, from which each entry is as far as its excess.
        heads = np.concatenate([graph.indices, np.fromiter(best, np.int32)])
        weights = np.concatenate([graph.data, [entry.excess for entry in best.values()]])
        ends = np.append(graph.indptr, graph.indptr[-1] + len(best)).astype(np.int32)
        excess, before = dijkstra(
            csr_array((weights, heads, ends), shape=(nodes + 1, nodes + 1)),
            indices=nodes,
            return_predecessors=True,
            limit=self.near.allowance,
        )
        improved = excess[:-1] < sheet.excess - ROUNDING
        sheet.excess[improved] = excess[:-1][improved]
        sheet.before[improved] = before[:-1][improved]
        sheet.entries.update((cell, e) for cell, e in best.items() if improved[cell])
        return improved

    def _leave(
        self,
        key: int,
        known: dict[int, Sheet],
        improved: BoolArray,
        pending: dict[int, list[Entry]],
    ) -> None:
        """Note the entries into other sheets from the cells [n] that are reached in less."""
        excess = known[key].excess[self.tails] + self.excess
        leaving = np.flatnonzero(improved[self.tails] & (excess <= self.near.allowance))
        found = (self.change[leaving] + np.uint64(key), self.heads[leaving], self.tails[leaving])
        for other, head, tail, cost in zip(
            *(array.tolist() for array in (*found, excess[leaving])), strict=True
        ):
            if other not in known or cost < known[other].excess[head] - ROUNDING:
                pending.setdefault(other, []).append(Entry(head, cost, key, tail))

    def _cells(self, entry: Entry, known: dict[int, Sheet]) -> list[int]:
        """Flat cells of the map, from the start by way of an entry to the goal."""
        way = self.near.onward_from(entry.cell)[::-1]
        while entry.sheet is not None:
            sheet, cell = known[entry.sheet], entry.tail
            way.append(cell)
            while (before := int(sheet.before[cell])) < len(sheet.before):
                way.append(cell := before)
            entry = sheet.entries[cell]
        return self.near.cells[way[::-1]].tolist()
