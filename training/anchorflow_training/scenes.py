"""Random scenes to plan in: a map of some family, a robot's state and a goal that it can reach."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from anchorflow_client.errors import AnchorFlowError
from anchorflow_training.scene_layouts import LAYOUTS, BoolArray, Canvas
from anchorflow_trajectory.cost.clearance import clearance_field, distance_to_cells
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene

FloatArray = NDArray[np.floating]


@lru_cache(maxsize=16)
def _edges(height: int, width: int) -> tuple[NDArray[np.int32], NDArray[np.int32], FloatArray]:
    """Pairs of neighbouring cells (8-connected, each once) and their distance in cells."""
    cells = np.arange(height * width, dtype=np.int32).reshape(height, width)
    pairs = [
        (cells[:, :-1], cells[:, 1:], 1.0),
        (cells[:-1], cells[1:], 1.0),
        (cells[:-1, :-1], cells[1:, 1:], np.sqrt(2.0)),
        (cells[:-1, 1:], cells[1:, :-1], np.sqrt(2.0)),
    ]
    tails = np.concatenate([a.ravel() for a, _, _ in pairs])
    heads = np.concatenate([b.ravel() for _, b, _ in pairs])
    steps = np.concatenate([np.full(a.size, c, np.float32) for a, _, c in pairs])
    return tails, heads, steps


def grid_graph(cost: FloatArray, cell_size: float) -> csr_array:
    """Undirected graph of the cells; an edge weighs its length [m] times its ends' mean cost."""
    tails, heads, steps = _edges(*cost.shape)
    flat = cost.ravel()
    weights = steps * cell_size * 0.5 * (flat[tails] + flat[heads])
    return csr_array((weights, (tails, heads)), shape=(flat.size, flat.size))


class SceneError(AnchorFlowError):
    """A layout left no room for a start and a goal; draw another."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FamilyScene(Scene):
    """A scene that knows its family, by which data and results are counted."""

    family: str


@dataclass(frozen=True)
class RobotRanges:
    """The robots and horizons that scenes are drawn for.

    v_max: m/s; a_max: m/s^2; robot_radius: m; horizon_s: s
    usual: share of scenes for the usual robot; fixed: share of scenes with a horizon
    sizes: m, sides of the maps, (least, most) of the small, the usual and the wide
    """

    v_max: tuple[float, float] = (0.2, 6.0)
    a_max: tuple[float, float] = (0.3, 8.0)
    robot_radius: tuple[float, float] = (0.1, 0.6)
    horizon_s: tuple[float, float] = (1.0, 120.0)
    usual: float = 0.4
    fixed: float = 0.2
    sizes: tuple[tuple[float, float], ...] = ((3.0, 7.0), (7.0, 14.0), (14.0, 60.0))


SIZE_SHARES = (0.2, 0.6, 0.2)
PENALTIES = (0.5, 12.0)  # m of detour that a metre through soft cost 1 is worth
LONGER = (1.15, 4.0)  # a horizon over the least time for the shortest route


def draw_scene(
    rng: np.random.Generator,
    *,
    cells: int = 96,
    limits: MotionLimits,
    robots: RobotRanges = RobotRanges(),
) -> FamilyScene:
    """A random scene on a `cells` x `cells` map; raises `SceneError` where the draw has no room.

    limits: of the usual robot; robots: what others may be like
    """
    families = list(LAYOUTS)
    shares = np.array([LAYOUTS[f][1] for f in families])
    family = families[rng.choice(len(families), p=shares / shares.sum())]
    size = float(rng.uniform(*robots.sizes[rng.choice(len(robots.sizes), p=SIZE_SHARES)]))
    radius = float(np.clip(rng.lognormal(np.log(0.25), 0.35), *robots.robot_radius))
    if rng.random() >= robots.usual:
        v_max, a_max = (
            float(np.exp(rng.uniform(*np.log(r)))) for r in (robots.v_max, robots.a_max)
        )
        limits = MotionLimits(v_max, a_max)
    resolution = size / cells
    occupied = _oriented(rng, family, cells, resolution, radius)
    clearance = clearance_field(occupied, resolution, radius)
    start, goal = _ends(rng, clearance, resolution)
    origin = np.full(2, -size / 2)
    x_curr, x_goal = np.zeros(6, np.float32), np.zeros(4, np.float32)
    for target, cell in ((x_curr, start), (x_goal, goal)):
        jitter = rng.uniform(-0.4, 0.4, 2)
        target[:2] = origin + (np.array(cell)[::-1] + 0.5 + jitter) * resolution
    span = x_goal[:2] - x_curr[:2]
    if rng.random() < 0.5:
        x_curr[2:4] = _velocity(rng, clearance[start], limits, span)
        x_curr[4:6] = rng.normal(0.0, limits.a_max / 6, 2) * (rng.random() < 0.5)
    if rng.random() < 0.3:
        x_goal[2:4] = _velocity(rng, clearance[goal], limits, span)
    soft, penalty = _soft_cost(rng, occupied, resolution)
    scene = FamilyScene(
        family=family,
        cost_map=np.stack([occupied, np.ones_like(soft), soft]).astype(np.float32),
        resolution=resolution,
        origin=origin,
        robot_radius=radius,
        x_curr=x_curr,
        x_goal=x_goal,
        w_style=_style(rng),
        motion=limits,
        cost_penalty=penalty,
    )
    if rng.random() >= robots.fixed:
        return scene
    horizon_s = scene.reference_s * float(np.exp(rng.uniform(*np.log(LONGER))))
    horizon_s = float(np.clip(horizon_s, *robots.horizon_s))
    return replace(scene, motion=replace(limits, horizon_s=horizon_s))


def _oriented(
    rng: np.random.Generator, family: str, cells: int, resolution: float, radius: float
) -> BoolArray:
    """The family's layout, turned by a random angle half of the time; [cells, cells]."""
    layout = LAYOUTS[family][0]
    if rng.random() < 0.5:
        return np.rot90(layout(Canvas(rng, cells, resolution, radius)), int(rng.integers(4))).copy()
    larger = int(np.ceil(cells * np.sqrt(2)))
    drawn, angle = layout(Canvas(rng, larger, resolution, radius)), rng.uniform(0, 2 * np.pi)
    offset = np.arange(cells) - (cells - 1) / 2
    x, y = offset[None, :], offset[:, None]
    column = np.cos(angle) * x - np.sin(angle) * y + (larger - 1) / 2
    row = np.sin(angle) * x + np.cos(angle) * y + (larger - 1) / 2
    return drawn[np.rint(row).astype(int), np.rint(column).astype(int)]


def _ends(
    rng: np.random.Generator, clearance: FloatArray, resolution: float
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Start and goal cells (row, column), connected by a way."""
    # Some ends are snug against a wall, most are not.
    room = float(rng.choice([0.02, 0.1, 0.2]))
    open_cells = np.argwhere(clearance > room)
    if len(open_cells) < 20:
        raise SceneError("no open ground")
    across = rng.random() < 0.5
    starts = open_cells
    if across:  # as in the common benchmarks: from one side of the map to the other
        near = open_cells[:, 0] < 0.1 * len(clearance)
        starts = open_cells[near] if near.any() else open_cells
    start = tuple(starts[rng.integers(len(starts))])
    graph = grid_graph(np.where(clearance > 0, 1.0, np.inf).astype(np.float32), resolution)
    graph.data[~np.isfinite(graph.data)] = 0.0
    graph.eliminate_zeros()
    source = start[0] * clearance.shape[1] + start[1]
    length = dijkstra(graph, directed=False, indices=source).reshape(clearance.shape)
    straight = (
        np.hypot(*(np.indices(clearance.shape) - np.array(start)[:, None, None])) * resolution
    )
    fit = (clearance > room) & np.isfinite(length) & (straight > 1.0)
    if across:
        fit &= np.indices(clearance.shape)[0] > 0.75 * len(clearance)
    goals = np.argwhere(fit)
    if not len(goals):
        raise SceneError("no goal within reach")
    distance = straight[fit]
    detour = length[fit] / distance
    weight = distance * (1.0 + 4.0 * np.minimum(detour - 1.0, 1.0))
    goal = goals[rng.choice(len(goals), p=weight / weight.sum())]
    if rng.random() < 0.5 and across:
        return tuple(goal), start
    return start, tuple(goal)


def _velocity(
    rng: np.random.Generator, clearance: float, limits: MotionLimits, span: FloatArray
) -> FloatArray:
    """A velocity at an end of the way: mostly along it, slow where there is little room."""
    braking = np.sqrt(2 * 0.7 * limits.a_max * max(0.05, clearance + 0.15))
    speed = rng.uniform(0.05, 1.0) * min(limits.v_max, braking)
    angle = np.arctan2(span[1], span[0]) + rng.normal(0.0, 0.7)
    return speed * np.array([np.cos(angle), np.sin(angle)], np.float32)


def _soft_cost(
    rng: np.random.Generator, occupied: BoolArray, resolution: float
) -> tuple[FloatArray, float]:
    """c [H, W] in [0, 1] of free ground, none in half of the scenes, and its penalty."""
    if rng.random() < 0.5:
        return np.zeros(occupied.shape, np.float32), 0.0
    cells = len(occupied)
    kinds = (
        lambda: _patches(rng, cells),
        lambda: _inflation(rng, occupied, resolution),
        lambda: _slope(rng, cells),
        lambda: _stripes(rng, cells),
    )
    soft = kinds[rng.integers(len(kinds))]()
    if rng.random() < 0.3:
        soft = np.maximum(soft, kinds[rng.integers(len(kinds))]())
    return np.clip(soft, 0.0, 1.0).astype(np.float32), float(rng.uniform(*PENALTIES))


def _patches(rng: np.random.Generator, cells: int) -> FloatArray:
    """Smooth patches, some with sharp edges."""
    size = rng.uniform(0.04, 0.12) * cells
    noise = gaussian_filter(rng.normal(size=(cells, cells)), size, mode="wrap")
    raised = (noise / noise.std() - rng.uniform(0.0, 0.8)) / rng.choice([0.02, 0.5])
    return np.clip(raised, 0.0, 1.0) * rng.uniform(0.3, 1.0)


def _inflation(rng: np.random.Generator, occupied: BoolArray, resolution: float) -> FloatArray:
    """What a cost map's inflation layer makes of the obstacles."""
    distance = distance_to_cells(occupied, resolution)
    reach, fall = rng.uniform(0.4, 1.5), rng.uniform(1.0, 5.0)
    return np.where(distance < reach, np.exp(-fall * np.maximum(distance - 0.2, 0.0)), 0.0)


def _slope(rng: np.random.Generator, cells: int) -> FloatArray:
    """Dearer and dearer towards one side."""
    along = _along(rng, cells)
    return (along - along.min()) / np.ptp(along) * rng.uniform(0.3, 1.0)


def _stripes(rng: np.random.Generator, cells: int) -> FloatArray:
    """Dear bands beside cheap lanes."""
    period = rng.uniform(0.15, 0.6) * cells
    wave = (_along(rng, cells) / period + rng.random()) % 1.0
    return (wave < rng.uniform(0.2, 0.7)) * rng.uniform(0.3, 1.0)


def _along(rng: np.random.Generator, cells: int) -> FloatArray:
    """How far [H, W] cells lie along a random direction."""
    angle = rng.uniform(0.0, 2 * np.pi)
    rows, columns = np.indices((cells, cells))
    return np.cos(angle) * columns + np.sin(angle) * rows


def _style(rng: np.random.Generator) -> FloatArray:
    return rng.dirichlet(np.array([1.3, 1.1, 1.1])).astype(np.float32)
