"""What anchors tell of the way beyond a controller's horizon, and the grid that it looks at."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch

from anchorflow_benchmarks.closed_loop.clearance_grid import ClearanceGrid
from anchorflow_benchmarks.closed_loop.ways_left import ASIDE, BLOCKED, WaysLeft, clear_ways

GOAL = torch.tensor([6.0, 0.0])


def grid_of(occupied: np.ndarray, surface: np.ndarray | None = None) -> ClearanceGrid:
    """Cells of 0.05 m from (-2, -3)."""
    return ClearanceGrid.of(
        occupied,
        resolution=0.05,
        origin=np.array([-2.0, -3.0]),
        robot_radius=0.2,
        surface=surface,
    )


def detour(height: float) -> torch.Tensor:
    """[1, S, 2] up, across and down again to (4, 0), 2 m before the goal."""
    corners = np.array([[0, 0], [0, height], [4, height], [4, 0]], float)
    legs = [np.linspace(a, b, 40) for a, b in pairwise(corners)]
    return torch.from_numpy(np.concatenate(legs)[None]).float()


def test_the_way_left_is_that_along_the_path_and_on_to_the_goal() -> None:
    free = grid_of(np.zeros((120, 160), bool))
    ways = WaysLeft.along(detour(1.0), GOAL, torch.zeros(1))
    places = torch.tensor([[0.0, 0.0], [0.0, 1.0], [2.0, 1.0], [4.0, 0.0]])
    torch.testing.assert_close(
        ways.left_from(places, free), torch.tensor([8.0, 7.0, 5.0, 2.0]), atol=0.1, rtol=0.0
    )


def test_a_handicap_makes_a_way_longer() -> None:
    free = grid_of(np.zeros((120, 160), bool))
    both = torch.cat([detour(1.0), detour(1.0)])
    left = [
        float(WaysLeft.along(both, GOAL, torch.tensor(extra)).left_from(torch.zeros(1, 2), free)[0])
        for extra in ([0.0, 0.0], [1.5, 0.0], [1.5, 1.5])
    ]
    assert left[1] == pytest.approx(left[0])
    assert left[2] == pytest.approx(left[0] + 1.5)


def test_a_way_behind_a_wall_is_further_than_it_looks() -> None:
    occupied = np.zeros((120, 160), bool)
    beside = torch.tensor([[1.0, 0.6]])
    ways = WaysLeft.along(detour(1.0), GOAL, torch.zeros(1))
    near = float(ways.left_from(beside, grid_of(occupied))[0])
    # Straight aside or aslant: the least of ASIDE * hypot(0.4, u) + 6 - u.
    assert near == pytest.approx(6.0 + 0.4 * (ASIDE**2 - 1.0) ** 0.5, abs=0.1)
    occupied[74:76, 40:120] = True  # y = 0.75, between the place and the way
    assert float(ways.left_from(beside, grid_of(occupied))[0]) == pytest.approx(near + BLOCKED)


def test_clear_ways_keep_the_margin_or_what_the_robot_has() -> None:
    occupied = np.zeros((120, 160), bool)
    occupied[60:62, 80:82] = True  # at (2.05, 0.05)
    paths = torch.cat([detour(h)[:, :80] for h in (0.35, 0.5)])
    assert clear_ways(paths, grid_of(occupied), 0.0).tolist() == [True, True]
    assert clear_ways(paths, grid_of(occupied), 0.1).tolist() == [False, True]
    occupied[55, 40] = True  # 0.2 m beside the robot itself
    assert clear_ways(paths, grid_of(occupied), 0.1).tolist() == [True, True]


def test_the_place_of_the_hits_counts_and_not_the_cell() -> None:
    occupied = np.zeros((40, 40), bool)
    occupied[20, 20] = True
    places = np.zeros((40, 40, 2))
    places[20, 20] = [-2.0 + 20.9 * 0.05, -3.0 + 20.5 * 0.05]  # far in the cell, seen from the left
    at = torch.tensor(-2.0 + 10.5 * 0.05), torch.tensor(-3.0 + 20.5 * 0.05)
    assert float(grid_of(occupied, places).at(*at)) == pytest.approx(10.4 * 0.05 - 0.2, abs=1e-5)
    assert float(grid_of(occupied).at(*at)) == pytest.approx(9.5 * 0.05 - 0.2, abs=1e-5)
