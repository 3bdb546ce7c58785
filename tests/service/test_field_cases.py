"""Cost maps, starts and goals that people with robots reported, planned by the default bundle."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from anchorflow_client import STYLES, AnchorBatch, CostMap, InvalidRequest
from anchorflow_service.local import LocalClient

SIDE, CELL, RADIUS = 96, 0.05, 0.22
INFLATION_RADIUS, INFLATION_SCALE = 0.55, 3.0
Costs = NDArray[np.int_]


@pytest.fixture(scope="module")
def client() -> Iterator[LocalClient]:
    with LocalClient.of(threads=1) as client:
        yield client


def no_obstacles() -> Costs:
    return np.zeros((SIDE, SIDE), int)


def wall_with_door() -> Costs:
    """Two columns of obstacles across the map, with a door of 24 rows: 1.2 m."""
    costs = no_obstacles()
    costs[:, 47:49] = 254
    costs[36:60, 47:49] = 0
    return costs


def inflated(costs: Costs) -> Costs:
    """Inflate obstacles as Nav2 does."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    away = np.full(costs.shape, np.inf)  # m, between centres
    for row, column in np.argwhere(costs == 254):
        away = np.minimum(away, CELL * np.hypot(rows - row, columns - column))
    falling = (252 * np.exp(-INFLATION_SCALE * (away - RADIUS))).astype(int)
    around = np.where(away <= RADIUS, 253, np.where(away <= INFLATION_RADIUS, falling, 0))
    return np.where(costs == 254, 254, around)


def published(costs: Costs) -> Any:
    """Return the nav_msgs/OccupancyGrid that Nav2 makes of costs."""
    percent = np.select(
        [costs == 0, costs == 253, costs == 254, costs == 255],
        [0, 99, 100, -1],
        1 + 97 * (costs - 1) // 251,
    )
    position = SimpleNamespace(x=-SIDE * CELL / 2, y=-SIDE * CELL / 2, z=0.0)
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    origin = SimpleNamespace(position=position, orientation=turn)
    info = SimpleNamespace(resolution=CELL, width=SIDE, height=SIDE, origin=origin)
    header = SimpleNamespace(frame_id="map", stamp=SimpleNamespace(sec=1, nanosec=0))
    return SimpleNamespace(header=header, info=info, data=percent.ravel().tolist())


def plan(
    client: LocalClient,
    costs: Costs,
    start: tuple[float, float] = (-1.5, 0.0),
    goal: tuple[float, float] = (1.5, 0.0),
    **options: Any,
) -> AnchorBatch:
    fields = {"robot_radius": RADIUS, "num_samples": 32, "seed": 0} | options
    unknown = fields.pop("unknown", "obstacle")
    return client.plan(
        cost_map=CostMap.from_occupancy_grid(published(costs), unknown=unknown),
        x_curr=[*start, 0, 0, 0, 0],
        x_goal=[*goal, 0, 0],
        **fields,
    )


@pytest.mark.parametrize("style", STYLES)
def test_a_door_of_an_inflated_cost_map_is_open(client: LocalClient, style: str) -> None:
    """Case C1."""
    anchors = plan(client, inflated(wall_with_door()), w_style=style)

    assert anchors.safe.all()
    assert (anchors.clearance >= 0).all()


def test_a_start_in_inflation_is_a_start(client: LocalClient) -> None:
    """Case C2: 0.30 m before a wall."""
    anchors = plan(client, inflated(wall_with_door()), start=(-0.35, -1.8))

    assert anchors.safe.all()


def test_clear_start_frees_the_cells_under_the_robot(client: LocalClient) -> None:
    """Case C3: one lethal cell under the start."""
    costs = no_obstacles()
    costs[48, 20] = 254  # its centre at (-1.375, 0.025)

    with pytest.raises(InvalidRequest) as caught:
        plan(client, costs, start=(-1.37, 0.025))
    anchors = plan(client, costs, start=(-1.37, 0.025), clear_start=True)

    assert caught.value.field == "x_curr"
    assert "the nearest free one is at (-1.325, 0.025) m" in caught.value.message
    assert anchors.safe.all()


def test_clear_start_frees_no_cell_beside_the_robot(client: LocalClient) -> None:
    costs = no_obstacles()
    costs[48, 20] = costs[:, 30] = 254  # the wall is 0.5 m away, and closes the map

    anchors = plan(client, costs, start=(-1.37, 0.025), clear_start=True)

    assert not anchors.safe.any()


def wall() -> Costs:
    """A wall of 0.2 m from x = 1.1 to 1.3 m."""
    costs = no_obstacles()
    costs[:, 70:74] = 254
    return costs


def test_an_occupied_goal_becomes_the_nearest_place_that_can_be_reached(
    client: LocalClient,
) -> None:
    """Case C4: the goal is 0.1 m inside a wall of 0.2 m."""
    anchors = plan(client, wall(), goal=(1.2, 0.0), goal_tolerance={"position": 0.5})

    ends = anchors.trajectories[:, -1]
    assert anchors.safe.all()
    assert np.ptp(ends, axis=0).max() < 1e-5
    # The robot and the routes' slack of 0.02 m fit before the wall; a cell is 0.05 m.
    assert 1.1 - RADIUS - 0.02 - CELL <= ends[0, 0] <= 1.1 - RADIUS
    assert abs(ends[0, 1]) <= CELL


@pytest.mark.parametrize("tolerance", [None, {"position": 0.3}])
def test_an_occupied_goal_is_refused_without_enough_tolerance(
    client: LocalClient, tolerance: Any
) -> None:
    with pytest.raises(InvalidRequest) as caught:
        plan(client, wall(), goal=(1.2, 0.0), goal_tolerance=tolerance)
    assert caught.value.field == "x_goal"
    said = "within 0.3 m of a place that can be reached" if tolerance else "nearest free one is at"
    assert said in caught.value.message


def test_a_goal_that_cannot_be_reached_moves_to_this_side_of_the_wall(client: LocalClient) -> None:
    """The nearest free cells are behind the wall, where no route leads."""
    anchors = plan(client, wall(), goal=(1.55, 0.0), goal_tolerance={"position": 1.0})

    assert anchors.safe.all()
    assert (anchors.trajectories[:, -1, 0] < 1.1).all()


def test_a_goal_that_can_be_reached_stays_exactly(client: LocalClient) -> None:
    exact = plan(client, wall(), goal=(0.511, 0.123))
    tolerant = plan(client, wall(), goal=(0.511, 0.123), goal_tolerance={"position": 1.0})

    np.testing.assert_array_equal(exact.trajectories, tolerant.trajectories)


@pytest.mark.parametrize(
    ("unknown", "is_a_way"), [("obstacle", False), ("free", True), (0.5, True)]
)
def test_unknown_space_blocks_the_way_or_not_as_the_caller_says(
    client: LocalClient, unknown: Any, is_a_way: bool
) -> None:
    """Case C12: a band of unknown cells five wide across the map."""
    costs = no_obstacles()
    costs[:, 46:51] = 255

    anchors = plan(client, costs, unknown=unknown)

    assert anchors.safe.all() if is_a_way else not anchors.safe.any()


def test_a_goal_in_a_far_frame_is_named_in_that_frame(client: LocalClient) -> None:
    grid = published(wall())
    grid.info.origin.position.x += 500_000.0

    with pytest.raises(InvalidRequest, match=r"got \(500001, 0\) m of scene 0"):
        client.plan(
            cost_map=CostMap.from_occupancy_grid(grid),
            x_curr=[499998.5, 0, 0, 0, 0, 0],
            x_goal=[500001.2, 0, 0, 0],
            goal_tolerance={"position": 0.1},
        )
