"""Geodesic costs: straight where the ground is open, round the wall where it is not."""

import numpy as np
import pytest

from anchorflow_trajectory.clearance import clearance_field
from anchorflow_trajectory.geodesic import BLOCKED_COST, cost_to_go, pool

ORIGIN = np.zeros(2)
START, GOAL = np.asarray([1.0, 3.25], np.float32), np.asarray([5.5, 3.25], np.float32)


def way_through(occupied: np.ndarray) -> float:
    field = clearance_field(occupied, 0.1, 0.2)
    ways = cost_to_go(field, 0.1, ORIGIN, START, GOAL)
    assert ways.shape == (2, *occupied.shape)
    from_start, to_goal = ways
    assert from_start[32, 55] == pytest.approx(to_goal[32, 10], rel=1e-4)
    return float(from_start[32, 55])


def test_open_ground_costs_its_length() -> None:
    assert way_through(np.zeros((64, 64), bool)) == pytest.approx(4.5, abs=1e-4)


def test_a_wall_with_a_gap_costs_the_detour() -> None:
    wall = np.zeros((64, 64), bool)
    wall[10:, 32] = True
    assert 6.5 < way_through(wall) < 9.0


def test_a_closed_wall_is_dear_but_finite() -> None:
    wall = np.zeros((64, 64), bool)
    wall[:, 32] = True
    assert 4.5 + 0.3 * BLOCKED_COST < way_through(wall) < 4.5 + BLOCKED_COST


def test_pooling_keeps_the_best_of_each_block() -> None:
    field = np.arange(130 * 70, dtype=np.float32).reshape(130, 70)
    coarse, cell = pool(field, 0.1)
    assert coarse.shape == (44, 24)
    assert cell == pytest.approx(0.3)
    assert coarse[0, 0] == field[:3, :3].max()
