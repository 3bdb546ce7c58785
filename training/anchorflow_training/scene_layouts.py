"""Maps in the families that robots meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Canvas:
    """A square of `cells` a side of `resolution` metres, for a robot of `radius` metres."""

    rng: np.random.Generator
    cells: int
    resolution: float
    radius: float

    @property
    def size(self) -> float:
        """Side in m."""
        return self.cells * self.resolution

    def blank(self) -> BoolArray:
        return np.zeros((self.cells, self.cells), bool)

    def points(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """x and y of the cell centres in m, broadcastable."""
        centres = (np.arange(self.cells) + 0.5) * self.resolution
        return centres[None, :], centres[:, None]

    def index(self, metres: float) -> int:
        return round(metres / self.resolution)

    def passage(self, spare_low: float, spare_high: float) -> float:
        """Width [m] of an opening that leaves the robot this much to spare."""
        # Rasterising moves each edge by up to half a cell.
        return 2 * self.radius + self.rng.uniform(spare_low, spare_high) + self.resolution

    def spots(self, count: int) -> NDArray[np.floating]:
        return self.rng.uniform(0.0, self.size, (count, 2))


def discs(canvas: Canvas, *, low: float = 0.15, high: float = 1.0) -> BoolArray:
    """Round obstacles of mixed size."""
    rng, (x, y) = canvas.rng, canvas.points()
    radii = rng.uniform(low, rng.uniform(low, high), rng.integers(3, 60))
    share = np.cumsum(np.pi * radii**2) / canvas.size**2
    kept = radii[share < rng.uniform(0.04, 0.2)]
    filled = canvas.blank()
    for (cx, cy), radius in zip(canvas.spots(len(kept)), kept, strict=True):
        filled |= (x - cx) ** 2 + (y - cy) ** 2 <= radius**2
    return filled


def boxes(canvas: Canvas) -> BoolArray:
    """Turned rectangles: furniture, crates, cars."""
    rng, (x, y) = canvas.rng, canvas.points()
    filled, budget = canvas.blank(), rng.uniform(0.04, 0.22) * canvas.size**2
    for cx, cy in canvas.spots(60):
        half = rng.uniform(0.1, 0.12 * canvas.size, 2)
        angle = rng.uniform(0, np.pi) if rng.random() < 0.5 else 0.0
        along = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
        across = (y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)
        filled |= (np.abs(along) <= half[0]) & (np.abs(across) <= half[1])
        budget -= 4 * half[0] * half[1]
        if budget < 0:
            break
    return filled


def posts(canvas: Canvas) -> BoolArray:
    """Equal posts, clumped by a cellular automaton (after Perille et al., BARN, 2020)."""
    rng = canvas.rng
    radius = rng.choice([0.075, 0.15, 0.15, 0.2])
    count = max(8, int(canvas.size / (2 * radius)))
    alive = rng.random((count, count)) < rng.uniform(0.1, 0.3)
    for _ in range(rng.integers(0, 4)):
        padded = np.pad(alive, 1)
        windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).sum((2, 3)) - alive
        alive = np.where(alive, windows >= 2, windows >= 5) & (rng.random(alive.shape) < 0.98)
    spots = (np.argwhere(alive) + 0.5)[:, ::-1] * (canvas.size / count)
    filled, reach = canvas.blank(), int(np.ceil(radius / canvas.resolution)) + 1
    around = np.arange(-reach, reach + 1)
    for spot in spots:
        column, row = (spot / canvas.resolution).astype(int)
        rows, columns = (np.clip(i + around, 0, canvas.cells - 1) for i in (row, column))
        cx, cy = ((i + 0.5) * canvas.resolution for i in (columns[None], rows[:, None]))
        disc = (cx - spot[0]) ** 2 + (cy - spot[1]) ** 2 <= radius**2
        filled[rows[:, None], columns[None]] |= disc
    return filled


def forest(canvas: Canvas) -> BoolArray:
    """Random square blocks on a coarse grid."""
    rng = canvas.rng
    side = rng.uniform(0.2, 0.8)
    count = max(4, int(canvas.size / side))
    blocks = rng.random((count, count)) < rng.uniform(0.05, 0.2)
    return _enlarge(blocks, canvas.cells)


def gaps(canvas: Canvas) -> BoolArray:
    """Parallel walls, each with one to three openings."""
    rng, filled = canvas.rng, canvas.blank()
    at = rng.uniform(0.1, 0.3) * canvas.size
    while at < 0.92 * canvas.size:
        thickness = max(1, canvas.index(rng.uniform(0.1, 1.2)))
        start = canvas.index(at)
        filled[start : start + thickness] = True
        for _ in range(rng.integers(1, 4)):
            width = canvas.index(canvas.passage(0.1, 1.2))
            left = rng.integers(0, max(1, canvas.cells - width))
            filled[start : start + thickness, left : left + width] = False
        least = max(1.2, 4 * canvas.radius)
        at += rng.uniform(least, max(least, 0.5 * canvas.size))
    return filled


def rooms(canvas: Canvas) -> BoolArray:
    """Recursive division into rooms, a door or two in each wall, some furniture."""
    rng, filled = canvas.rng, canvas.blank()
    smallest = max(1.5, 5 * canvas.radius)
    wall = max(1, canvas.index(rng.uniform(0.08, 0.25)))

    def divide(top: int, left: int, height: int, width: int) -> None:
        longest = max(height, width) * canvas.resolution
        if longest < 2 * smallest or (longest < 0.6 * canvas.size and rng.random() < 0.25):
            return
        tall = height >= width
        extent = height if tall else width
        margin = min(canvas.index(smallest), extent // 2 - 1)
        cut = int(rng.integers(margin, extent - margin + 1))
        span = width if tall else height
        solid = np.ones(span, bool)
        for _ in range(rng.integers(1, 3)):
            door = min(span, canvas.index(canvas.passage(0.12, 0.8)))
            at = rng.integers(0, span - door + 1)
            solid[at : at + door] = False
        if tall:
            filled[top + cut : top + cut + wall, left : left + width] |= solid
            divide(top, left, cut, width)
            divide(top + cut + wall, left, height - cut - wall, width)
        else:
            filled[top : top + height, left + cut : left + cut + wall] |= solid[:, None]
            divide(top, left, height, cut)
            divide(top, left + cut + wall, height, width - cut - wall)

    divide(0, 0, canvas.cells, canvas.cells)
    return filled | boxes(canvas) if rng.random() < 0.3 else filled


def maze(canvas: Canvas) -> BoolArray:
    """A random spanning tree of corridors with some loops broken in."""
    rng = canvas.rng
    pitch = canvas.passage(0.2, 1.6) + 0.2
    count = int(np.clip(canvas.size / pitch, 3, 12))
    lattice = np.ones((2 * count + 1, 2 * count + 1), bool)
    lattice[1::2, 1::2] = False
    seen, stack = {(0, 0)}, [(0, 0)]
    while stack:
        row, column = stack[-1]
        near = [(row + i, column + j) for i, j in ((0, 1), (1, 0), (0, -1), (-1, 0))]
        fresh = [n for n in near if min(n) >= 0 and max(n) < count and n not in seen]
        if not fresh:
            stack.pop()
            continue
        to = fresh[rng.integers(len(fresh))]
        lattice[row + to[0] + 1, column + to[1] + 1] = False
        seen.add(to)
        stack.append(to)
    inner = rng.random(lattice.shape) < rng.uniform(0.05, 0.4)
    lattice[1:-1, 1:-1] &= ~inner[1:-1, 1:-1]
    wall = max(1, canvas.index(rng.uniform(0.08, 0.3)))
    cell = canvas.cells // count
    sizes = np.tile([wall, max(1, cell - wall)], count + 1)[: 2 * count + 1]
    drawn = np.repeat(np.repeat(lattice, sizes, 0), sizes, 1)
    filled = canvas.blank()
    side = min(canvas.cells, len(drawn))
    filled[:side, :side] = drawn[:side, :side]
    return filled


def corridors(canvas: Canvas) -> BoolArray:
    """Solid ground in which crooked passages are cut."""
    rng, (x, y) = canvas.rng, canvas.points()
    free = canvas.blank()
    knots = canvas.spots(int(rng.integers(4, 9)))
    for _ in range(rng.integers(2, 5)):
        way = knots[rng.permutation(len(knots))[: rng.integers(2, 5)]]
        half = canvas.passage(0.15, 1.5) / 2
        for a, b in pairwise(way):
            span = b - a
            along = ((x - a[0]) * span[0] + (y - a[1]) * span[1]) / (span @ span + 1e-9)
            along = np.clip(along, 0.0, 1.0)
            free |= (x - a[0] - along * span[0]) ** 2 + (y - a[1] - along * span[1]) ** 2 <= half**2
    return ~free


def city(canvas: Canvas) -> BoolArray:
    """Blocks of buildings between streets of differing width, with yards and cut corners."""
    rng, (x, y) = canvas.rng, canvas.points()

    def streets() -> BoolArray:
        solid, at = np.ones(canvas.cells, bool), rng.uniform(-1.0, 2.0)
        while at < canvas.size:
            width = canvas.passage(0.3, 2.0)
            solid[max(0, canvas.index(at)) : max(0, canvas.index(at + width))] = False
            at += width + rng.uniform(1.0, 0.35 * canvas.size)
        return solid

    filled = streets()[None, :] & streets()[:, None]
    for _ in range(rng.integers(0, 3)):
        angle, half = rng.uniform(0, np.pi), canvas.passage(0.3, 1.5) / 2
        cx, cy = canvas.spots(1)[0]
        filled &= np.abs((x - cx) * np.sin(angle) - (y - cy) * np.cos(angle)) > half
    yards = discs(canvas, low=0.4, high=1.5)
    return filled & ~yards if rng.random() < 0.5 else filled


def bug_traps(canvas: Canvas) -> BoolArray:
    """U-shaped walls whose open side may face the wrong way."""
    rng, filled = canvas.rng, canvas.blank()
    wall = max(1, canvas.index(rng.uniform(0.1, 0.4)))
    for _ in range(rng.integers(1, 4)):
        height, width = (canvas.index(s) for s in rng.uniform(0.2, 0.55, 2) * canvas.size)
        top, left = (int(rng.integers(0, canvas.cells - s)) for s in (height, width))
        shape = np.zeros((height, width), bool)
        shape[:wall] = shape[-wall:] = True
        shape[:, :wall] = shape[:, -wall:] = True
        side = int(rng.integers(4))
        mouth = canvas.index(canvas.passage(0.15, 1.0))
        turned = np.rot90(shape, side)
        if rng.random() < 0.5:
            turned[wall:-wall, :wall] = False
        else:
            at = int(rng.integers(wall, max(wall + 1, len(turned) - wall - mouth)))
            turned[at : at + mouth, :wall] = False
        rows, columns = turned.shape
        part = filled[top : top + rows, left : left + columns]
        part |= turned[: part.shape[0], : part.shape[1]]
    return filled


def empty(canvas: Canvas) -> BoolArray:
    """Open ground, now and then with a single thing on it."""
    return discs(canvas) & (canvas.rng.random() < 0.3)


def mixed(canvas: Canvas) -> BoolArray:
    """Structure with clutter in it."""
    structure = [rooms, gaps, bug_traps, city][canvas.rng.integers(4)]
    clutter = [posts, forest, discs, boxes][canvas.rng.integers(4)]
    keep = canvas.rng.random((4, 4)) < canvas.rng.uniform(0.2, 0.8)
    return structure(canvas) | (clutter(canvas) & _enlarge(keep, canvas.cells))


def _enlarge(blocks: BoolArray, cells: int) -> BoolArray:
    """Nearest-neighbour enlargement of a square grid."""
    index = np.arange(cells) * len(blocks) // cells
    return blocks[index[:, None], index[None, :]]


LAYOUTS: dict[str, tuple[Callable[[Canvas], BoolArray], float]] = {
    # family: (layout, share of the scenes)
    "discs": (discs, 1.0),
    "boxes": (boxes, 1.0),
    "posts": (posts, 2.0),
    "forest": (forest, 1.2),
    "gaps": (gaps, 1.2),
    "rooms": (rooms, 1.5),
    "maze": (maze, 1.2),
    "corridors": (corridors, 0.8),
    "city": (city, 1.2),
    "bug_traps": (bug_traps, 1.2),
    "empty": (empty, 0.2),
    "mixed": (mixed, 1.2),
}
