"""Cells and steps: who stands where, and which neighbours can be stepped on."""

import numpy as np

from anchorflow_trajectory.routes.dijkstra import LENGTHS, STEPS, cell_index, free_steps


def test_a_point_is_in_its_cell_and_one_beyond_in_the_nearest() -> None:
    origin = np.array([-1.0, 2.0])

    def cell(x: float, y: float) -> int:
        return cell_index(np.array([x, y]), origin, 0.5, (4, 6))

    assert cell(-0.9, 2.1) == 0
    assert cell(0.1, 2.6) == 6 + 2
    assert cell(9.0, 9.0) == 4 * 6 - 1
    assert cell(-9.0, 2.6) == 6


def test_the_step_back_stands_in_the_mirrored_place() -> None:
    np.testing.assert_array_equal(STEPS, -STEPS[::-1])
    np.testing.assert_array_equal(LENGTHS, np.hypot(*STEPS.T))


def test_steps_lead_between_free_cells_and_cut_no_corner() -> None:
    free = np.array([[1, 1, 0], [1, 1, 1]], bool)
    found = {
        (cell, cell + STEPS[k, 0] * 3 + STEPS[k, 1])
        for cell, steps in enumerate(free_steps(free).tolist())
        for k in range(8)
        if steps >> k & 1
    }
    there = {(0, 1), (0, 3), (0, 4), (1, 3), (1, 4), (3, 4), (4, 5)}  # not from 1 to 5
    assert found == there | {(head, tail) for tail, head in there}
