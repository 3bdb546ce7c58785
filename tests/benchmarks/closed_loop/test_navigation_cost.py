"""What MPPI sees of the map, and what it prefers."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from anchorflow_benchmarks.closed_loop.clearance_grid import ClearanceGrid
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.navigation_cost import NavigationCost
from anchorflow_benchmarks.closed_loop.robots import Unicycle
from anchorflow_trajectory.clearance import GridField, distance_to_cells

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


def test_what_is_nearer_to_the_goal_at_the_end_costs_less() -> None:
    grid, states = grid_of(np.zeros((80, 120), bool)), torch.zeros(3, 30, 5)
    states[:, :, 0] = torch.tensor([0.0, 2.0, 4.0])[:, None] * torch.linspace(0.0, 1.0, 30)
    still, slow, fast = cost_of(states, grid, NavigationCost())
    assert still > slow > fast


def test_mppi_drives_off_towards_the_goal() -> None:
    torch.manual_seed(0)
    free = grid_of(np.zeros((80, 120), bool))
    mppi = MppiController(Unicycle(), MppiConfig(samples=64, steps=20), tick_s=0.1)
    state = Unicycle().start(np.zeros(3))
    for _ in range(10):
        command, chosen = mppi.command(state, grid=free, goal=GOAL)
        state = Unicycle().step(state, command, 0.1)
        assert chosen is None
    assert float(state[0]) > 0.5
    assert abs(float(state[1])) < 0.5


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
    _, chosen = mppi.command(state, grid=grid_of(occupied), goal=GOAL, paths=paths)

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
    mppi.command(state, grid=free, goal=GOAL, paths=paths)

    assert rolled == 32 * 10


def test_a_plan_of_longer_steps_passes_tick_by_tick() -> None:
    mppi = MppiController(Unicycle(), MppiConfig(samples=16, steps=4, dt=0.2), tick_s=0.1)
    mppi._held.plan = torch.tensor([[1.0, 0.0], [3.0, 0.0], [0.0, 0.0], [2.0, 0.0]])
    mppi._shift()
    np.testing.assert_allclose(mppi._held.plan[:, 0].numpy(), [2.0, 1.5, 1.0, 1.0])
