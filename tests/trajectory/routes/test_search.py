"""Routes: as many as the geometry has, as long as it says, free, and told apart."""

from __future__ import annotations

import heapq
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.ndimage import label
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from anchorflow_trajectory.cost.clearance import clearance_field
from anchorflow_trajectory.routes.dijkstra import LENGTHS, STEPS, free_steps
from anchorflow_trajectory.routes.homotopy import ObstacleRays
from anchorflow_trajectory.routes.search import (
    MOST_ROUTES,
    SLACK,
    STRETCH,
    Route,
    find_routes,
    free_cells,
)
from anchorflow_trajectory.routes.shortening import pulled_tight

SEEDS = (1, 3, 24, 28)
CELL, RADIUS = 0.1, 0.25
ORIGIN = np.array([-3.2, -3.2])


@dataclass(frozen=True)
class World:
    """Cells of 0.1 m centred on (0, 0), to be crossed from left to right.

    surcharge: [64, 64] of ground that is dear but passable
    """

    occupied: np.ndarray
    start: np.ndarray
    goal: np.ndarray
    surcharge: np.ndarray | None = None

    @property
    def clearance(self) -> np.ndarray:
        return clearance_field(self.occupied, CELL, RADIUS)

    def routes(self, **limits: float) -> list[Route]:
        return find_routes(
            self.clearance,
            resolution=CELL,
            origin=ORIGIN,
            start=self.start,
            goal=self.goal,
            surcharge=self.surcharge,
            **limits,  # pyright: ignore[reportArgumentType]
        )

    def tight(self, **limits: float) -> list[Route]:
        return pulled_tight(
            self.routes(**limits),
            self.clearance,
            resolution=CELL,
            origin=ORIGIN,
            surcharge=self.surcharge,
        )

    def dear(self, surcharge: float, *patches: tuple[slice, slice]) -> World:
        """The same world with patches of this surcharge."""
        ground = np.zeros((64, 64), np.float32)
        for patch in patches:
            ground[patch] = surcharge
        return replace(self, surcharge=ground)


def world(*blocks: tuple[slice, slice]) -> World:
    """From (-2.55, 0.05) to (2.55, 0.05), with blocks [rows, columns] of occupied cells."""
    occupied = np.zeros((64, 64), bool)
    for block in blocks:
        occupied[block] = True
    return World(occupied, np.array([-2.55, 0.05]), np.array([2.55, 0.05]))


def box(row: int, column: int, size: int = 5) -> tuple[slice, slice]:
    """A square of cells about one of them."""
    half = size // 2
    return slice(row - half, row + half + 1), slice(column - half, column + half + 1)


def test_open_ground_has_one_route_as_long_as_it_is_wide() -> None:
    (route,) = world().routes()

    assert route.signature == ()
    assert route.length == pytest.approx(5.1)
    np.testing.assert_allclose(route.points[[0, -1]], [[-2.55, 0.05], [2.55, 0.05]])


def test_a_post_has_two_routes_as_long_as_the_geometry_says() -> None:
    case = world(box(32, 32))
    # Round a square of 0.25 m half a side, which robot and slack blow up, its corners to arcs.
    room = RADIUS + SLACK
    near, reach = 2.55 - 0.25, np.hypot(2.55 - 0.25, 0.25)
    turn = np.arctan2(0.25, near) + np.arcsin(room / reach)
    around = 2 * (np.sqrt(reach**2 - room**2) + room * turn) + 0.5
    routes = case.tight()

    assert {route.signature for route in routes} == {(0,), (1,)}
    assert [route.length for route in routes] == pytest.approx([around, around], abs=CELL)


def test_the_way_on_the_nearer_side_is_the_shortest() -> None:
    below, above = world(box(35, 32)).routes()

    assert (below.signature, above.signature) == ((0,), (1,))
    assert above.length > below.length + 2 * CELL
    assert below.points[:, 1].min() < 0.05 < above.points[:, 1].max()


def test_two_posts_side_by_side_have_three_routes_and_one_behind_the_other_four() -> None:
    beside = world(box(24, 32), box(40, 32)).routes()
    behind = world(box(32, 22), box(32, 42)).routes()

    assert {route.signature for route in beside} == {(0, 0), (1, 0), (1, 1)}
    assert beside[0].signature == (1, 0)  # between them, which is straight
    assert beside[0].length == pytest.approx(5.1)
    assert {route.signature for route in behind} == {(0, 0), (0, 1), (1, 0), (1, 1)}


def test_a_wall_with_two_gaps_has_two_routes() -> None:
    wall = slice(31, 33)
    case = world((slice(0, 16), wall), (slice(26, 38), wall), (slice(48, 64), wall))
    upper, lower = case.tight()

    # Only the middle piece can be gone round.
    assert {upper.signature, lower.signature} == {(0,), (1,)}
    # By a corner of the middle piece, which ends 0.55 m above the way and 0.65 m below it.
    room = RADIUS + SLACK
    lengths = [0.2 + 2 * np.hypot(2.45, end + room) for end in (0.55, 0.65)]
    assert [upper.length, lower.length] == pytest.approx(lengths, abs=2 * CELL)


def test_a_gap_that_the_robot_does_not_fit_through_is_none() -> None:
    wall = slice(31, 33)
    wide = world((slice(0, 30), wall), (slice(37, 64), wall))
    narrow = world((slice(0, 30), wall), (slice(35, 64), wall))

    assert len(wide.routes()) == 1  # 0.7 m for a robot of 0.5 m
    assert narrow.routes() == []


def test_a_step_between_two_corners_is_not_taken() -> None:
    clearance = np.ones((8, 8))
    clearance[:4, 4:] = clearance[4:, :4] = -1.0  # two rooms that touch in a point

    ends = {"start": np.array([1.5, 1.5]), "goal": np.array([6.5, 6.5])}
    assert find_routes(clearance, resolution=1.0, origin=np.zeros(2), **ends) == []  # pyright: ignore[reportArgumentType]


def test_a_dear_patch_has_a_route_on_either_side_and_no_loops() -> None:
    above, below = world().dear(3.0, box(33, 32, 15)).tight()

    assert {above.signature, below.signature} == {(0,), (1,)}
    assert above.charge == below.charge == 0.0
    # Round a square of 0.75 m half a side, whose middle is 0.1 m above the way.
    lengths = [1.5 + 2 * np.hypot(1.8, end) for end in (0.6, 0.8)]
    assert [above.length, below.length] == pytest.approx(lengths, abs=1.5 * CELL)
    assert len(world().dear(12.0, box(32, 32, 5)).routes(stretch=2.0)) == 2


def test_a_band_that_cannot_be_gone_round_is_crossed_where_it_is_narrow() -> None:
    wide, narrow = (slice(0, 64), slice(28, 36)), (slice(40, 44), slice(28, 36))
    case = world().dear(9.0, wide)
    assert case.surcharge is not None
    case.surcharge[narrow] = 1.0

    (route,) = case.tight(most=1)

    assert route.charge == pytest.approx(0.8, abs=CELL)
    assert route.cost < world().routes()[0].length + 0.8 * 9.0
    crossing = np.interp([0.0], *route.points.T)
    assert 0.8 < crossing[0] < 1.2


def test_a_wide_detour_is_not_worth_a_little_dear_ground() -> None:
    (route,) = world().dear(0.4, box(32, 32, 31)).routes()
    assert route.length == pytest.approx(5.1)
    assert route.charge == pytest.approx(0.4 * 3.1, rel=0.05)


def test_limits_are_kept() -> None:
    case = world(box(24, 32), box(40, 32))
    every = case.routes(stretch=1.5)

    assert case.routes(most=2, stretch=1.5)[-1].signature == every[1].signature
    assert len(case.routes(most=1)) == 1
    assert len(case.routes(stretch=1.0)) == 1
    assert len(every) > len(case.routes(stretch=1.05))
    for wrong in ({"most": 0}, {"stretch": 0.9}, {"slack": -0.1}, {"stretch": float("nan")}):
        with pytest.raises(ValueError, match=r"expected most >= 1, stretch >= 1 and slack >= 0"):
            case.routes(**wrong)


def test_a_loop_round_a_post_is_a_route_of_its_own_where_it_is_short_enough() -> None:
    signatures = [route.signature for route in world(box(40, 32, 1)).routes(stretch=2.0)]

    assert signatures[:2] == [(0,), (1,)]
    assert {(-1,), (2,)} & set(signatures)


def test_who_stands_close_to_an_obstacle_may_leave() -> None:
    case = world(box(36, 6, 3))
    assert case.clearance.ravel()[32 * 64 + 6] < SLACK
    assert case.routes()


@st.composite
def worlds(draw: st.DrawFn) -> World:
    """Up to nine posts of up to seven cells a side, clear of both ends."""
    where = st.tuples(st.integers(4, 59), st.integers(14, 49), st.sampled_from((1, 3, 5, 7)))
    return world(*(box(*post) for post in draw(st.lists(where, max_size=9))))


@settings(max_examples=40, deadline=None)
@given(worlds())
def test_every_route_is_free_and_no_two_are_alike(case: World) -> None:
    clearance = case.clearance
    ends = [32 * 64 + 6, 32 * 64 + 57]
    free = free_cells(clearance, ends, slack=SLACK)
    routes, rays = case.routes(), ObstacleRays.of(clearance)

    assert [r.length for r in routes] == sorted(r.length for r in routes)
    assert len({r.signature for r in routes}) == len(routes) <= MOST_ROUTES
    for route in (*routes, *case.tight()):
        columns, rows = ((route.points - ORIGIN) / CELL).astype(int).T
        assert free[rows, columns].all()
        np.testing.assert_allclose(route.points[[0, -1]], [case.start, case.goal])
        assert route.length == pytest.approx(
            np.linalg.norm(np.diff(route.points, axis=0), axis=1).sum()
        )
        (signature,) = rays.signatures(route.points[None], resolution=CELL, origin=ORIGIN)
        assert signature == route.signature
    again = case.routes()
    assert [r.points.tolist() for r in again] == [r.points.tolist() for r in routes]


@settings(max_examples=40, deadline=None)
@given(worlds())
def test_the_cheapest_route_costs_what_scipy_finds(case: World) -> None:
    case = case.dear(2.5, (slice(10, 40), slice(20, 30)), (slice(30, 60), slice(28, 50)))
    assert case.surcharge is not None
    ends = [32 * 64 + 6, 32 * 64 + 57]
    steps = free_steps(free_cells(case.clearance, ends, slack=SLACK))
    cells, places = np.nonzero(steps[:, None] >> np.arange(8) & 1)
    heads = (cells + STEPS[places] @ (64, 1)).astype(int)
    surcharge = case.surcharge.ravel()
    mean = 0.5 * (surcharge[cells] + surcharge[heads])
    even, dear = (
        csr_array((weights, (cells, heads)), shape=(64 * 64, 64 * 64))
        for weights in (LENGTHS[places], LENGTHS[places] * (1.0 + mean))
    )
    length, cost = (float(dijkstra(graph, indices=ends[0])[ends[1]]) for graph in (even, dear))

    found = replace(case, surcharge=None).routes(most=1)
    assert [route.length for route in found] == pytest.approx(
        [CELL * length] if np.isfinite(length) else [], rel=1e-12
    )
    # Half a step at the border of a patch is looked up on one side of it or the other.
    cheapest = [route.cost for route in case.routes(most=1)]
    assert cheapest == pytest.approx([CELL * cost] if np.isfinite(cost) else [], abs=2.5 * CELL)
    for loose, tight in zip(case.routes(), case.tight(), strict=True):
        assert tight.cost <= loose.cost + 1e-9


def test_threads_find_the_same_routes() -> None:
    rng = np.random.default_rng(5)
    cases = [
        world(*(box(*rng.integers((12, 14), (52, 50)).tolist()) for _ in range(count)))
        for count in range(24)
    ]

    def told(case: World) -> list[bytes]:
        return [route.points.tobytes() for route in case.tight()]

    alone = [told(case) for case in cases]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(told, 4 * cases)) == 4 * alone


@pytest.mark.parametrize("seed", SEEDS)
def test_the_routes_are_those_of_a_plain_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(12, 52, 12), rng.integers(14, 50, 12)
    sizes = rng.choice([1, 3], 12)
    posts = np.stack([rows, columns, sizes], axis=-1).tolist()
    case = world(*(box(*post) for post in posts))
    found = {r.signature: r.length for r in case.routes(most=6)}
    expected = plain_search(case, most=6, stretch=STRETCH)

    assert len(found) > 1
    # Any of the routes as long as the last one may be listed.
    assert sorted(found.values()) == pytest.approx(sorted(expected.values()))
    assert all(expected.get(s, length) == pytest.approx(length) for s, length in found.items())


def plain_search(case: World, *, most: int, stretch: float) -> dict[tuple[int, ...], float]:
    """Uniform-cost search over pairs of cell and whole signature, cell by cell."""
    free = free_cells(case.clearance, [32 * 64 + 6, 32 * 64 + 57], slack=SLACK)
    rays = ObstacleRays.of(case.clearance)
    heap = [(0.0, (32, 6), (0,) * len(rays.rows))]
    done, found, per_cell = set(), {}, {}
    while heap and len(found) < most:
        length, cell, signature = heapq.heappop(heap)
        if (cell, signature) in done or per_cell.get(cell, 0) >= most:
            continue
        done.add((cell, signature))
        per_cell[cell] = per_cell.get(cell, 0) + 1
        if found and length > stretch * min(found.values()) / CELL + 1e-6:
            break
        if cell == (32, 57):
            found[signature] = length * CELL
        for dr, dc in ((r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c):
            row, column = cell[0] + dr, cell[1] + dc
            if not (0 <= row < 64 and 0 <= column < 64):
                continue
            if not (free[row, column] and free[cell[0], column] and free[row, cell[1]]):
                continue
            left, at = min(column, cell[1]), cell[0] if dc > 0 else row
            crossed = tuple(
                s + (dc if dc and c == left and at > r else 0)
                for s, r, c in zip(signature, rays.rows, rays.columns, strict=True)
            )
            heapq.heappush(heap, (length + float(np.hypot(dr, dc)), (row, column), crossed))
    return found


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from((0.05, 0.2, 0.4)))
def test_obstacles_are_the_connected_parts_that_touch_no_edge(seed: int, share: float) -> None:
    blocked = np.random.default_rng(seed).random((20, 30)) < share
    labels = np.asarray(label(blocked, np.ones((3, 3)))[0])  # pyright: ignore[reportIndexIssue]
    outer = {0, *labels[0], *labels[-1], *labels[:, 0], *labels[:, -1]}
    numbers, first = np.unique(labels, return_index=True)
    cells = [cell for number, cell in zip(numbers, first, strict=True) if number not in outer]

    rays = ObstacleRays.of(np.where(blocked, -1.0, 1.0))
    assert (rays.rows * 30 + rays.columns).tolist() == cells
    assert rays.shape == (20, 30)


def test_a_path_crosses_the_rays_above_which_it_passes() -> None:
    clearance = np.ones((9, 9))
    clearance[2, 2] = clearance[4, 6] = -1.0
    above = np.array([[0.5, 5.5], [8.5, 5.5]])
    between = np.array([[0.5, 3.5], [4.5, 3.5], [4.5, 2.5], [8.5, 2.5]])
    twice = np.array([[2.5, 5.5], [3.5, 5.5], [3.5, 1.5], [1.5, 1.5], [1.5, 5.5], [3.5, 5.5]])

    def signature(path: np.ndarray) -> tuple[int, ...]:
        origin = np.array([10.0, -20.0])
        (found,) = ObstacleRays.of(clearance).signatures(
            path[None] * 0.5 + origin, resolution=0.5, origin=origin
        )
        return found

    assert signature(above) == (1, 1)
    assert signature(above[::-1]) == (-1, -1)
    assert signature(between) == (1, 0)
    assert signature(twice) == (2, 0)
