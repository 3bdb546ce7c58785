"""The search over places and times finds what is cheapest among walls and what moves, in time."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.cost.fields import CostFields
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import Discs, MovingDiscs, place_at
from anchorflow_trajectory.routes.space_time import SpaceTime

CELL, SIDE, RADIUS, STEPS = 0.1, 80, 0.2, 49
START, GOAL = np.array([-3.0, 0.0]), np.array([3.0, 0.0])
WALL = np.zeros((SIDE, SIDE), bool)
WALL[:50, 38:42] = True  # across the way, open above y = 1
Disc = tuple[tuple[float, float], tuple[float, float]]


def searched(
    *discs: Disc,
    walls: np.ndarray | None = None,
    radius: float = RADIUS,
    horizon_s: float = 6.0,
    speed: float = 0.0,
    goal: np.ndarray = GOAL,
    longest: float = 12.0,
) -> tuple[SpaceTime, CostFields]:
    """Return the lattice from START at `speed` m/s towards +x, and the fields that it is in."""
    occupied = np.zeros((SIDE, SIDE), bool) if walls is None else walls
    field = clearance_field(occupied, CELL, radius)
    numbers = np.array(discs, float).reshape(-1, 2, 2)
    movers = MovingDiscs.of(numbers[:, 0], numbers[:, 1], np.full(len(numbers), 0.3 + radius))
    origin = np.full(2, -0.5 * SIDE * CELL)
    fields = CostFields(GridField(field, CELL, origin), None, movers)
    limits, velocity = MotionLimits(2.0, 2.0, horizon_s), np.array([speed, 0.0])
    ends, sizes = (START, velocity, goal), {"longest": longest, "hurry": 0.94, "room": 0.05}
    return SpaceTime.of(fields, limits, *ends, **sizes), fields


def ways(lattice: SpaceTime, goal: np.ndarray = GOAL) -> np.ndarray:
    return lattice.ways_to(lattice.node(goal), STEPS)[0]


def nearest(way: np.ndarray, fields: CostFields, horizon_s: float) -> float:
    """Return the least distance to what moves [m], at the time of each sample."""
    assert fields.movers is not None
    discs, times = Discs.of(fields.movers, np.float64), np.linspace(0.0, horizon_s, len(way))
    return min(
        float(np.hypot(*(place - place_at(discs, j, time)))) - discs.radius[j]
        for place, time in zip(way, times, strict=True)
        for j in range(len(discs.radius))
    )


def test_ways_up_to_a_length_stay_on_it_and_much_longer_ones_do_not() -> None:
    goal = START + np.array([1.5, 1.0])
    searched_in, fields = searched(goal=goal, longest=4.0)
    upper = searched_in.origin + searched_in.size * (np.array(searched_in.costs.shape[1:]) - 1)
    low = fields.clearance.origin
    places = np.random.default_rng(0).uniform(low, -low, (20_000, 2))
    length = sum(np.linalg.norm(places - end, axis=-1) for end in (START, goal))
    over = np.maximum(searched_in.origin - places, places - upper).max(-1)
    assert over[length <= 4.0].max() < searched_in.size
    assert (over[length > 6.0] > 0.0).mean() > 0.9


def test_nothing_in_the_way_is_passed_straight_and_evenly() -> None:
    way = ways(searched()[0])[0]
    assert np.abs(way[:, 1]).max() < 0.15
    assert way[[0, -1]] == pytest.approx(np.stack([START, GOAL]), abs=0.1)
    pace = np.diff(way[:, 0]) * (STEPS - 1) / 6.0
    assert pace[8:].max() < 1.5  # m/s, where the way takes 1.0


def test_walls_are_gone_round() -> None:
    lattice, fields = searched(walls=WALL)
    found = ways(lattice)
    assert len(found) > 1
    for way in found:
        assert fields.clearance.sample(*way.T).min() > -CELL
        assert way[:, 1].max() > 1.0


@pytest.mark.parametrize("column", [37, 38, 39, 40])
def test_no_move_jumps_over_a_thin_wall(column: int) -> None:
    closed = np.zeros((SIDE, SIDE), bool)
    closed[:, column] = True
    assert not len(ways(searched(walls=closed, radius=0.01)[0]))


@pytest.mark.parametrize(("crosses_s", "is_before"), [(2.6, False), (4.2, True)])
def test_who_crosses_is_passed_before_or_behind(crosses_s: float, is_before: bool) -> None:
    lattice, fields = searched(((0.0, -1.2 * crosses_s), (0.0, 1.2)))
    found = ways(lattice)
    assert min(nearest(way, fields, 6.0) for way in found) > -0.15  # between nodes
    middle_s = np.abs(found[..., 0]).argmin(axis=1) * 6.0 / (STEPS - 1)
    assert ((middle_s < crosses_s) == is_before).all()


def test_an_end_that_is_too_far_for_the_time_has_no_way_and_another_is_found() -> None:
    lattice, _ = searched(horizon_s=2.0)
    assert not len(ways(lattice))
    end = lattice.nearest_end(GOAL)
    assert end is not None
    found, velocity = lattice.ways_to(end, STEPS)
    assert found[0, -1, 0] == pytest.approx(-0.2, abs=0.35)  # 3 m of the 6, from rest
    assert velocity[0] > 1.5


def test_the_start_counts_with_its_velocity() -> None:
    """Whoever comes at 2 m/s gets farther, and cannot turn at once."""
    (resting, _), (moving, _) = searched(horizon_s=1.0), searched(horizon_s=1.0, speed=1.8)
    reached = [
        np.argwhere(each.costs[-1] < 1e8) * each.size + each.origin for each in (resting, moving)
    ]
    assert reached[1][:, 0].max() > reached[0][:, 0].max() + 0.5
    assert reached[1][:, 0].min() > START[0]


def test_a_goal_that_somebody_takes_is_neared() -> None:
    lattice, fields = searched((tuple(GOAL), (0.0, 0.0)))
    assert not len(ways(lattice))
    end = lattice.nearest_end(GOAL)
    assert end is not None
    way = lattice.ways_to(end, STEPS)[0][0]
    assert 0.5 < np.hypot(*(way[-1] - GOAL)) < 1.0
    assert nearest(way, fields, 6.0) > 0.0


def test_nowhere_to_go_is_no_end() -> None:
    around = [((-3.0 + x, y), (-x, -y)) for x, y in [(1, 0), (-1, 0), (0, 1), (0, -1), (0.8, 0.8)]]
    assert searched(*around, horizon_s=4.0)[0].nearest_end(GOAL) is None
