"""The cost of motions, the cost to go along anchors, and what MPPI prefers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch

from anchorflow_benchmarks.closed_loop.cost_to_go import (
    BLOCKED_COST,
    OFF_PATH_COST,
    ClearanceGrid,
    CostToGo,
    NavigationCost,
    clear_paths,
)
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.robots import Unicycle
from anchorflow_trajectory.cost.clearance import GridField, distance_to_cells

GOAL = torch.tensor([6.0, 0.0])


def grid_of(occupied: np.ndarray, resolution: float = 0.1) -> ClearanceGrid:
    """A map centred on (3, 0)."""
    height, width = occupied.shape
    origin = np.array([3.0 - width * resolution / 2, -height * resolution / 2])
    return ClearanceGrid.of(occupied, resolution=resolution, origin=origin, robot_radius=0.25)


def cost_of(states: torch.Tensor, grid: ClearanceGrid, cost: NavigationCost) -> torch.Tensor:
    controls = torch.zeros(*states.shape[:2], 2)
    return cost.of(Unicycle(), states, controls, grid=grid, goal=GOAL, dt=0.1)


def test_clearance_is_looked_up_as_everywhere_else_in_the_project() -> None:
    occupied = np.random.default_rng(0).random((40, 50)) < 0.05
    origin = np.array([-1.0, 2.0])
    grid = ClearanceGrid.of(occupied, resolution=0.1, origin=origin, robot_radius=0.0)
    outside, inside = distance_to_cells(occupied, 0.1), distance_to_cells(~occupied, 0.1)
    field = GridField(outside - inside, 0.1, origin.astype(np.float32))
    x, y = np.random.default_rng(1).uniform([-0.9, 2.1], [3.8, 5.8], (500, 2)).astype(np.float32).T

    found = grid.at(torch.from_numpy(x), torch.from_numpy(y)).numpy()
    np.testing.assert_allclose(found, field.sample(x, y), atol=2e-4)


def test_the_edge_of_the_map_is_no_obstacle() -> None:
    grid = grid_of(np.zeros((40, 40), bool))
    assert float(grid.at(torch.tensor(100.0), torch.tensor(0.0))) > 3.0


def test_a_motion_through_a_wall_costs_more_than_the_way_round() -> None:
    occupied = np.zeros((80, 120), bool)
    occupied[30:50, 60] = True  # x = 3, y from -1 to 1
    grid, share = grid_of(occupied), torch.linspace(0.0, 1.0, 30)
    states = torch.zeros(2, 30, 5)
    states[:, :, 0] = 6.0 * share
    states[1, :, 1] = 1.8 * torch.sin(torch.pi * share)
    through, around = cost_of(states, grid, NavigationCost())

    assert through > around + 10.0


def test_an_anchor_round_a_wall_is_gone_on_from() -> None:
    occupied = np.zeros((120, 160), bool)
    occupied[50:70, 52] = True  # x = 0.2, y from -1 to 1
    state = Unicycle().start(np.array([-0.5, 0.0, 0.0]))
    bend = np.sin(np.pi * np.linspace(0.0, 1.0, 64))
    blind, round_it = (
        np.stack([np.linspace(-0.5, 6.0, 64), -side * bend], 1) for side in (0.0, 5.0)
    )
    paths = torch.from_numpy(np.stack([blind, round_it])).float()
    config = MppiConfig(steps=60, samples=64, cruise=1.0)
    mppi = MppiController(Unicycle(), config, tick_s=0.1)
    _, chosen = mppi.decide(state, grid=grid_of(occupied), goal=GOAL, paths=paths)

    assert chosen == 1
    assert float(mppi.planned(state)[-1, 1]) < -1.0


@pytest.mark.parametrize("anchors", [0, 5])
def test_every_tick_rolls_out_the_same_number_of_motions(anchors: int) -> None:
    rolled = 0

    class Counting(Unicycle):
        def step(self, state: torch.Tensor, control: torch.Tensor, dt: float) -> torch.Tensor:
            nonlocal rolled
            rolled += len(state)
            return super().step(state, control, dt)

    config = MppiConfig(samples=32, steps=10)
    mppi = MppiController(Counting(), config, tick_s=0.1)
    paths = torch.zeros(anchors, 64, 2) if anchors else None
    state, free = Unicycle().start(np.zeros(3)), grid_of(np.zeros((40, 40), bool))
    mppi.decide(state, grid=free, goal=GOAL, paths=paths)

    assert rolled == 32 * 10


def fine_grid(occupied: np.ndarray, surface: np.ndarray | None = None) -> ClearanceGrid:
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
    free = fine_grid(np.zeros((120, 160), bool))
    to_go = CostToGo.along(detour(1.0), GOAL, torch.zeros(1))
    places = torch.tensor([[0.0, 0.0], [0.0, 1.0], [2.0, 1.0], [4.0, 0.0]])
    torch.testing.assert_close(
        to_go.left_from(places, free), torch.tensor([8.0, 7.0, 5.0, 2.0]), atol=0.1, rtol=0.0
    )


def test_a_handicap_makes_a_way_longer() -> None:
    free = fine_grid(np.zeros((120, 160), bool))
    both = torch.cat([detour(1.0), detour(1.0)])
    left = [
        float(CostToGo.along(both, GOAL, torch.tensor(extra)).left_from(torch.zeros(1, 2), free)[0])
        for extra in ([0.0, 0.0], [1.5, 0.0], [1.5, 1.5])
    ]
    assert left[1] == pytest.approx(left[0])
    assert left[2] == pytest.approx(left[0] + 1.5)


def test_a_way_behind_a_wall_is_further_than_it_looks() -> None:
    occupied = np.zeros((120, 160), bool)
    beside = torch.tensor([[1.0, 0.6]])
    to_go = CostToGo.along(detour(1.0), GOAL, torch.zeros(1))
    near = float(to_go.left_from(beside, fine_grid(occupied))[0])
    # Straight aside or aslant: the least of OFF_PATH_COST * hypot(0.4, u) + 6 - u.
    assert near == pytest.approx(6.0 + 0.4 * (OFF_PATH_COST**2 - 1.0) ** 0.5, abs=0.1)
    occupied[74:76, 40:120] = True  # y = 0.75, between the place and the way
    assert float(to_go.left_from(beside, fine_grid(occupied))[0]) == pytest.approx(
        near + BLOCKED_COST
    )


def test_clear_paths_keep_the_margin_or_what_the_robot_has() -> None:
    occupied = np.zeros((120, 160), bool)
    occupied[60:62, 80:82] = True  # at (2.05, 0.05)
    paths = torch.cat([detour(h)[:, :80] for h in (0.35, 0.5)])
    assert clear_paths(paths, fine_grid(occupied), 0.0).tolist() == [True, True]
    assert clear_paths(paths, fine_grid(occupied), 0.1).tolist() == [False, True]
    occupied[55, 40] = True  # 0.2 m beside the robot itself
    assert clear_paths(paths, fine_grid(occupied), 0.1).tolist() == [True, True]


def test_the_place_of_the_hits_counts_and_not_the_cell() -> None:
    occupied = np.zeros((40, 40), bool)
    occupied[20, 20] = True
    places = np.zeros((40, 40, 2))
    places[20, 20] = [-2.0 + 20.9 * 0.05, -3.0 + 20.5 * 0.05]  # far in the cell, seen from the left
    at = torch.tensor(-2.0 + 10.5 * 0.05), torch.tensor(-3.0 + 20.5 * 0.05)
    assert float(fine_grid(occupied, places).at(*at)) == pytest.approx(10.4 * 0.05 - 0.2, abs=1e-5)
    assert float(fine_grid(occupied).at(*at)) == pytest.approx(9.5 * 0.05 - 0.2, abs=1e-5)
