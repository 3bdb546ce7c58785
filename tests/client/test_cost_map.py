"""The cost map's geometry: cells, extent, frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anchorflow_client import CostMap, InvalidRequest

SHAPE = (16, 20)


def cost_map(resolution: float = 0.5, origin: tuple[float, float] | None = None) -> CostMap:
    return CostMap.build(np.zeros((1, *SHAPE)), resolution, origin)


def test_a_map_without_an_origin_is_centred() -> None:
    np.testing.assert_array_equal(cost_map().extent, [[-5.0, -4.0], [5.0, 4.0]])


def test_the_row_grows_with_y_and_the_column_with_x() -> None:
    grid = cost_map(origin=(0.0, 0.0))

    assert grid.cell_of(0.1, 0.1) == (0, 0)
    assert grid.cell_of(0.1, 7.9) == (15, 0)
    assert grid.cell_of(9.9, 0.1) == (0, 19)


@given(
    row=st.integers(0, SHAPE[0] - 1),
    column=st.integers(0, SHAPE[1] - 1),
    resolution=st.floats(0.01, 10),
    origin=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
)
def test_the_centre_of_a_cell_lies_in_it(
    row: int, column: int, resolution: float, origin: tuple[float, float]
) -> None:
    grid = cost_map(resolution, origin)
    centre = grid.origin + resolution * np.array([column + 0.5, row + 0.5])

    assert grid.cell_of(*centre) == (row, column)
    assert grid.contains(*centre)


def test_channel_0_is_the_occupancy() -> None:
    data = np.random.default_rng(0).random((2, 3, *SHAPE))

    occupancy = CostMap.build(data, 0.1).occupancy

    np.testing.assert_array_equal(occupancy, data[:, 0].astype(np.float32))


def test_a_map_does_not_change_with_the_array_that_a_read_only_view_is_of() -> None:
    live = np.zeros((1, *SHAPE), np.float32)
    view = live.view()
    view.flags.writeable = False
    grid = CostMap.build(view, 0.5)
    live[:] = 1.0

    assert grid.data.max() == 0.0


def test_what_nobody_can_write_to_is_not_copied() -> None:
    memory = memoryview(bytes(4 * 16 * 20))
    data = np.frombuffer(memory, np.float32).reshape(1, *SHAPE)
    grid = CostMap.build(data, 0.5)

    assert np.shares_memory(grid.data, data)
    assert np.shares_memory(CostMap.from_fields(grid).data, data)
    changing = np.frombuffer(memoryview(bytearray(memory)).toreadonly(), np.float32)
    assert not np.shares_memory(CostMap.build(changing.reshape(1, *SHAPE), 0.5).data, changing)


def test_what_a_mask_hides_is_looked_at() -> None:
    data = np.ma.masked_array(np.zeros((1, *SHAPE), np.float32), mask=False)
    data[0, 3, 4] = np.ma.masked
    data.data[0, 3, 4] = np.nan

    with pytest.raises(InvalidRequest, match=r"finite numbers, got nan at cost_map.data\[0\]\[3\]"):
        CostMap.build(data, 0.5)


def test_a_point_far_away_is_in_the_nearest_cell_however_fine_the_map() -> None:
    grid = cost_map(resolution=1e-6)

    assert grid.cell_of(1e7, -1e7) == (0, 19)
