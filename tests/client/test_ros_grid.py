"""Grids from ROS: costs, messages, unknown space, windows and updates."""

from __future__ import annotations

from array import array
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from anchorflow_client import CostMap, InvalidRequest, RosGrid

SIDE = 16
COSTS = [0, 1, 100, 252, 253, 254, 255]


def grid_of(values: list[int], dtype: type = np.int16) -> np.ndarray[Any, Any]:
    """Values along the first row of 16 × 16 cells of 0."""
    cells = np.zeros((SIDE, SIDE), dtype)
    cells[0, : len(values)] = values
    return cells


def message(
    data: Any, *, stamp: tuple[int, int] = (10, 500_000_000), turn: float = 0.0, frame: str = "map"
) -> SimpleNamespace:
    """A nav_msgs/OccupancyGrid of 16 columns and 20 rows of 0.05 m."""
    origin = SimpleNamespace(
        position=SimpleNamespace(x=-1.0, y=2.0, z=0.0),
        orientation=SimpleNamespace(x=0.0, y=0.0, z=float(np.sin(turn / 2)), w=1.0),
    )
    info = SimpleNamespace(resolution=0.05, width=16, height=20, origin=origin)
    return SimpleNamespace(header=header(stamp, frame), info=info, data=data)


def header(stamp: tuple[int, int], frame: str = "map") -> SimpleNamespace:
    sec, nanosec = stamp
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame)


def update(data: list[int], *, stamp: tuple[int, int] = (11, 0), **changed: Any) -> Any:
    """A map_msgs/OccupancyGridUpdate of 3 columns and 2 rows."""
    fields: dict[str, Any] = {"x": 5, "y": 7, "width": 3, "height": 2} | changed
    frame = fields.pop("frame", "map")
    return SimpleNamespace(header=header(stamp, frame), data=data, **fields)


def test_nav2s_costs_become_obstacles_and_risk() -> None:
    cost_map = CostMap.from_nav2(grid_of(COSTS, np.uint8), 0.05, (1.0, 2.0))

    obstacle, traversability, risk = cost_map.data[:, 0]
    assert_array_equal(obstacle[:8], [0, 0, 0, 0, 0, 1, 1, 0])
    assert_allclose(risk[:8], [0, 1 / 253, 100 / 253, 252 / 253, 1, 0, 0, 0], rtol=1e-6)
    assert (traversability == 1).all()
    assert (cost_map.resolution, cost_map.origin.tolist()) == (0.05, [1.0, 2.0])


def test_a_published_cost_map_means_what_its_costs_mean() -> None:
    published = [0 if i == 0 else int(1 + 97 * (i - 1) / 251) for i in COSTS[:4]] + [99, 100, -1]

    from_costs = CostMap.from_nav2(grid_of(COSTS), 0.05)
    from_grid = CostMap.from_occupancy_grid(grid_of(published), 0.05)

    assert_array_equal(from_grid.data[:2], from_costs.data[:2])
    assert_allclose(from_grid.data[2], from_costs.data[2], atol=251 / 97 / 253)


def test_an_inscribed_cell_is_an_obstacle_for_a_robot_of_radius_0() -> None:
    costs = CostMap.from_nav2(grid_of(COSTS), 0.05, inscribed_is_obstacle=True)
    grid = CostMap.from_occupancy_grid(grid_of([99, 98]), 0.05, inscribed_is_obstacle=True)

    assert_array_equal(costs.data[[0, 2], 0, 4], [1, 0])
    assert_array_equal(grid.data[0, 0, :2], [1, 0])


def test_probabilities_are_obstacles_from_65_percent_on() -> None:
    grid = CostMap.from_occupancy_grid(grid_of([0, 30, 64, 65, 99, 100]), 0.05, inflated=False)

    assert_array_equal(grid.data[0, 0, :6], [0, 0, 0, 1, 1, 1])
    assert_allclose(grid.data[2, 0, :6], [0, 0.3, 0.64, 0, 0, 0], rtol=1e-6)


@pytest.mark.parametrize(
    ("unknown", "obstacle", "risk"), [("obstacle", 1, 0), ("free", 0, 0), (0.7, 0, 0.7), (1, 0, 1)]
)
def test_unknown_space_is_what_the_caller_says(unknown: Any, obstacle: int, risk: float) -> None:
    for cost_map in (
        CostMap.from_nav2(grid_of([255]), 0.05, unknown=unknown),
        CostMap.from_occupancy_grid(grid_of([-1]), 0.05, unknown=unknown),
    ):
        assert_allclose(cost_map.data[:, 0, 0], [obstacle, 1, risk], rtol=1e-6)


@pytest.mark.parametrize("unknown", ["dear", -0.1, 1.5, True, None, float("nan")])
def test_unknown_space_has_no_other_meaning(unknown: Any) -> None:
    with pytest.raises(
        InvalidRequest, match=r'unknown: expected "obstacle", "free" or a soft cost'
    ):
        CostMap.from_nav2(grid_of([]), 0.05, unknown=unknown)


@pytest.mark.parametrize("container", [list, lambda data: array("b", data), np.array])
def test_a_message_is_read_with_its_frame(container: Any) -> None:
    data = [0] * 320
    data[16 * 3 + 2] = 100
    cost_map = CostMap.from_occupancy_grid(message(container(data)))

    assert cost_map.data.shape == (3, 20, 16)
    assert_array_equal(np.argwhere(cost_map.occupancy == 1), [[3, 2]])
    assert_array_equal(cost_map.extent, [[-1.0, 2.0], [-1.0 + 16 * 0.05, 3.0]])


def test_a_raw_message_has_nav2s_costs() -> None:
    grid = message([])
    metadata = SimpleNamespace(resolution=0.05, size_x=16, size_y=20, origin=grid.info.origin)
    raw = SimpleNamespace(header=grid.header, metadata=metadata, data=array("B", [253] * 320))

    assert (CostMap.from_nav2(raw).data[2] == 1).all()
    with pytest.raises(InvalidRequest, match=r"expected an OccupancyGrid, got a nav2_msgs/Costmap"):
        CostMap.from_occupancy_grid(raw)
    with pytest.raises(InvalidRequest, match=r"expected a nav2_msgs/Costmap, got an OccupancyGrid"):
        CostMap.from_nav2(message([0] * 320))


@pytest.mark.parametrize("turn", [-3.06e-17, 2 * np.pi, 4 * np.pi])
def test_a_turn_that_is_rounding_is_none(turn: float) -> None:
    assert RosGrid.of(message([0] * 320, turn=turn)).origin.tolist() == [-1.0, 2.0]


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"turn": 0.1}, "origin: expected a grid that is not turned"),
        ({"data": [0] * 319}, "data: expected 20 rows of 16 cells, got 319 cells"),
        ({"data": [0] * 319 + [101]}, "expected numbers from -1 to 100, got 101 at data[19][15]"),
        ({"data": [0.5] * 320}, "data: expected whole numbers, got an array of float64"),
    ],
)
def test_a_message_that_cannot_be_read_is_refused(changed: Any, complaint: str) -> None:
    with pytest.raises(InvalidRequest) as caught:
        RosGrid.of(message(**({"data": [0] * 320} | changed)))
    assert complaint in str(caught.value)


def test_a_message_has_its_own_resolution() -> None:
    with pytest.raises(InvalidRequest, match="resolution: expected none, as the grid has its own"):
        CostMap.from_occupancy_grid(message([0] * 320), 0.05)


def test_a_window_of_a_large_grid_keeps_its_place_and_is_unknown_beyond_it() -> None:
    cells = np.zeros((600, 700), np.int8)
    cells[10, 5] = 100

    cost_map = CostMap.from_occupancy_grid(
        cells, 0.1, (0.0, 0.0), unknown=0.5, center=(0.5, 1.0), size_m=2.0
    )

    assert cost_map.data.shape == (3, 20, 20)
    assert_allclose(cost_map.origin, [-0.5, 0.0], atol=1e-12)
    assert_array_equal(np.argwhere(cost_map.occupancy == 1), [[10, 10]])
    assert (cost_map.data[2, :, :5] == 0.5).all()
    assert not cost_map.data[2, :, 5:].any()
    with pytest.raises(InvalidRequest, match="both center and size_m"):
        CostMap.from_occupancy_grid(cells, 0.1, (0.0, 0.0), size_m=2.0)


def test_an_update_changes_its_cells_alone() -> None:
    grid = RosGrid.of(message([0] * 320))

    updated = grid.updated(update([100, 99, 50, -1, 1, 0]))

    assert_array_equal(updated.values[7:9, 5:8], [[100, 99, 50], [-1, 1, 0]])
    assert np.count_nonzero(updated.values[:, :]) == 5
    assert not grid.values[:, :].any()
    assert_array_equal(CostMap.from_occupancy_grid(updated).occupancy[7, 5:8], [1, 0, 0])


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"stamp": (10, 0)}, "update.stamp: expected an update of this grid, of 10.500000000 s or"),
        ({"frame": "odom"}, "update.frame_id: expected map, got odom"),
        (
            {"x": 14},
            "update: expected an area of this grid of 16 by 20 cells, got columns 14 to 17",
        ),
        ({"y": 19}, "rows 19 to 21"),
        ({"x": -1}, "columns -1 to 2"),
        ({"width": 2}, "data: expected 2 rows of 2 cells, got 6 cells"),
    ],
)
def test_an_update_of_another_grid_is_refused(changed: dict[str, Any], complaint: str) -> None:
    grid = RosGrid.of(message([0] * 320))

    with pytest.raises(InvalidRequest) as caught:
        grid.updated(update([100] * 6, **changed))
    assert complaint in str(caught.value)


def test_an_update_that_a_later_one_overtook_is_refused() -> None:
    grid = RosGrid.of(message([0] * 320)).updated(update([100] * 6, stamp=(12, 0)))

    with pytest.raises(InvalidRequest, match="expected an update of this grid, of 12"):
        grid.updated(update([0] * 6, stamp=(11, 0)))


def test_a_raw_update_belongs_to_a_raw_grid() -> None:
    grid = RosGrid.of(message([0] * 320))
    raw = SimpleNamespace(header=header((11, 0)), x=5, y=7, size_x=3, size_y=2, data=[254] * 6)

    with pytest.raises(InvalidRequest, match="expected an OccupancyGridUpdate, got a CostmapUpd"):
        grid.updated(raw)

    costs = RosGrid(values=np.zeros((20, 16), np.uint8), resolution=0.05, origin=np.zeros(2))
    assert (CostMap.from_nav2(costs.updated(raw)).occupancy[7:9, 5:8] == 1).all()
