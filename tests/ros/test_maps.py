"""Grids and their updates, windows, and what the values mean."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from anchorflow_client import InvalidRequest
from anchorflow_ros.maps import MapMeaning, MapReader

HERE = np.array([2.0, 2.0])


def wall(size: int = 40) -> np.ndarray[Any, Any]:
    cells = np.zeros((size, size), np.int8)
    cells[10:20, 25] = 100
    return cells


def update(make: Any, stamp: float = 11.0, **changed: Any) -> SimpleNamespace:
    """The fields of map_msgs/OccupancyGridUpdate, whose package has no wheel."""
    fields: dict[str, Any] = {"x": 3, "y": 4, "width": 2, "height": 2, "data": [100] * 4}
    return SimpleNamespace(header=make.grid(wall(), stamp=stamp).header, **fields | changed)


def test_an_update_changes_the_grid_that_it_was_made_for(make: Any) -> None:
    reader = MapReader()
    reader.on_grid(make.grid(wall()), now=1.0)
    before = reader.cost_map(HERE)

    reader.on_update(update(make), now=2.0)

    after = reader.cost_map(HERE)
    assert_array_equal(np.argwhere(after.occupancy != before.occupancy).max(0), [5, 4])
    assert reader.changed_at == 2.0


@pytest.mark.parametrize(
    "changed",
    [{"x": 39}, {"data": [100] * 3}, {"data": [101] * 4}, {"stamp": 9.0}],
    ids=["beyond the grid", "too short", "no cost", "older than the grid"],
)
def test_a_malformed_update_is_refused_and_the_map_kept(make: Any, changed: dict[str, Any]) -> None:
    reader = MapReader()
    reader.on_grid(make.grid(wall()), now=1.0)
    kept = reader.cost_map(HERE)

    with pytest.raises(InvalidRequest):
        reader.on_update(update(make, **changed), now=2.0)

    assert reader.cost_map(HERE) is kept
    assert reader.changed_at == 1.0


def test_an_update_before_any_grid_is_refused(make: Any) -> None:
    with pytest.raises(InvalidRequest, match="expected a whole grid before its updates"):
        MapReader().on_update(update(make), now=1.0)


def test_a_malformed_grid_is_refused_and_the_map_kept(make: Any) -> None:
    reader = MapReader()
    reader.on_grid(make.grid(wall()), now=1.0)
    kept = reader.cost_map(HERE)
    bad = make.grid(wall(), stamp=11.0)
    bad.info.width = 41

    with pytest.raises(InvalidRequest, match="expected 40 rows of 41 cells"):
        reader.on_grid(bad, now=2.0)

    assert reader.cost_map(HERE) is kept


def test_the_cost_map_is_made_once_while_the_map_is_the_same(make: Any) -> None:
    reader = MapReader()
    reader.on_grid(make.grid(wall()), now=1.0)
    first = reader.cost_map(HERE)

    assert reader.cost_map(HERE + 1.0) is first
    reader.on_grid(make.grid(wall(), stamp=10.5), now=1.5)
    assert reader.cost_map(HERE) is not first


def test_a_window_follows_the_robot(make: Any) -> None:
    reader = MapReader(MapMeaning(window_m=2.0))
    reader.on_grid(make.grid(wall(600)), now=1.0)

    near = reader.cost_map(HERE)
    same, moved = reader.cost_map(HERE + 0.1), reader.cost_map(HERE + np.array([1.0, 0.0]))

    assert same is near
    assert near.data.shape == (3, 20, 20)
    assert_allclose(near.origin, [1.0, 1.0])
    assert_allclose(moved.origin, [2.0, 1.0])


def test_a_large_map_requires_a_window(make: Any) -> None:
    reader = MapReader()
    reader.on_grid(make.grid(wall(600)), now=1.0)

    with pytest.raises(InvalidRequest, match=r"at most 512 cells.*600 by 600; set map\.window_m"):
        reader.cost_map(HERE)


@pytest.mark.parametrize(("unknown", "occupied", "risk"), [("free", 0, 0), ("0.25", 0, 0.25)])
def test_unknown_space_counts_as_the_parameter_says(
    make: Any, unknown: str, occupied: float, risk: float
) -> None:
    cells = wall()
    cells[0, 0] = -1
    reader = MapReader(MapMeaning(unknown=unknown))
    reader.on_grid(make.grid(cells), now=1.0)

    cost_map = reader.cost_map(HERE)

    assert cost_map.data[:, 0, 0].tolist() == [occupied, 1, risk]


def test_a_meaning_that_is_none_is_refused() -> None:
    with pytest.raises(InvalidRequest, match=r"map\.unknown.*got the string 'wall'"):
        MapMeaning(unknown="wall")
