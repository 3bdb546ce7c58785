"""Clearance against closed forms: the distance to squares, not to their centres."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.ndimage import distance_transform_edt

from anchorflow_trajectory.cost.clearance import (
    GridField,
    clearance_field,
    distance_in_cells,
    distance_to_cells,
)
from anchorflow_trajectory.finish.certificate import path_clearance

ORIGIN = np.array([-1.0, -2.0])


def test_distance_is_to_the_square() -> None:
    cells = np.zeros((9, 9), bool)
    cells[4, 4] = True
    distance = distance_to_cells(cells, 0.5)
    assert distance[4, 4] == 0.0
    assert distance[4, 6] == pytest.approx(0.75)  # two cells away: 1.5 cells to the near edge
    assert distance[6, 6] == pytest.approx(0.5 * np.hypot(1.5, 1.5))


def test_clearance_falls_into_obstacles_and_past_the_edge() -> None:
    occupied = np.zeros((20, 20), bool)
    occupied[8:12, 8:12] = True
    field = clearance_field(occupied, 0.1, 0.25)
    assert field[10, 10] < field[10, 8] < -0.25 < field[10, 6]
    assert field[0, 0] == pytest.approx(0.05)  # half a cell to the map's edge
    grid = GridField(field, 0.1, np.zeros(2))
    outside = grid.sample(np.asarray([-0.3], np.float32), np.asarray([1.0], np.float32))
    assert outside[0] == pytest.approx(-0.3, abs=1e-5)


def test_an_empty_and_a_full_map() -> None:
    edge = np.minimum(np.arange(16), np.arange(16)[::-1]) * 0.1 + 0.05
    expected = np.minimum(edge[:, None], edge)
    empty = clearance_field(np.zeros((16, 16), bool), 0.1, 0.2)
    np.testing.assert_allclose(empty, expected, atol=1e-6)
    full = clearance_field(np.ones((16, 16), bool), 0.1, 0.2)
    assert (full < 0).all()
    assert np.isfinite(full).all()


def test_interpolation_is_exact_on_a_bilinear_field() -> None:
    x = ORIGIN[0] + (np.arange(30) + 0.5) * 0.2
    y = ORIGIN[1] + (np.arange(20) + 0.5) * 0.2
    values = (1.0 + 2 * x[None] - y[:, None] + 0.5 * x[None] * y[:, None]).astype(np.float32)
    field = GridField(values, 0.2, ORIGIN)
    rng = np.random.default_rng(1)
    px, py = rng.uniform(-0.8, 4.0, 50), rng.uniform(-1.8, 1.0, 50)
    value, along_x, along_y = field.sample_with_gradient(
        np.asarray(px, np.float32), np.asarray(py, np.float32)
    )
    np.testing.assert_allclose(value, 1 + 2 * px - py + 0.5 * px * py, atol=1e-5)
    np.testing.assert_allclose(along_x, 2 + 0.5 * py, atol=2e-5)
    np.testing.assert_allclose(along_y, -1 + 0.5 * px, atol=2e-5)
    np.testing.assert_allclose(
        field.sample(np.asarray(px, np.float32), np.asarray(py, np.float32)), value, atol=1e-6
    )


def test_path_clearance_sees_between_the_samples() -> None:
    occupied = np.zeros((40, 40), bool)
    occupied[20, 20] = True
    field = GridField(clearance_field(occupied, 0.1, 0.2), 0.1, np.zeros(2))
    straddling = np.asarray([[[1.0, 2.05], [3.0, 2.05]], [[1.0, 1.0], [3.0, 1.0]]], np.float32)
    clearance = path_clearance(field, straddling)
    assert clearance[0] == pytest.approx(-0.25, abs=0.03)
    assert clearance[1] == pytest.approx(0.8, abs=0.002)


@given(
    shape=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    share=st.sampled_from((0.002, 0.02, 0.1, 0.3, 0.9)),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_nearest_cell_is_the_one_that_scipy_finds(
    shape: tuple[int, int], share: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.random(shape) < share
    cells[rng.integers(shape[0]), rng.integers(shape[1])] = True
    nearest = distance_transform_edt(~cells, return_distances=False, return_indices=True)
    apart = np.abs(np.asarray(nearest) - np.indices(shape))

    # Cells with equally near centres may have squares at other distances: both pick the same cell.
    expected = np.sqrt((np.maximum(apart - 0.5, 0.0) ** 2).sum(0))
    np.testing.assert_array_equal(distance_in_cells(cells), expected)


def test_without_a_set_cell_all_is_infinitely_far() -> None:
    assert np.isposinf(distance_in_cells(np.zeros((3, 5), bool))).all()
