"""The distance transform is scipy's, to the last bit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from anchorflow_trajectory.cost.clearance import distance_in_cells


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
