"""Drawings of a map, of trajectories and of their ends."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from anchorflow_trajectory.drawing import draw_cells, draw_ends, hide_ticks


def test_a_map_is_drawn_from_edge_to_edge_in_metres() -> None:
    axes = Figure().add_subplot()
    cells = np.arange(6.0).reshape(2, 3)
    image = draw_cells(axes, cells, resolution=0.5, origin=(-1.0, 4.0), vmax=5.0)
    hide_ticks(axes)

    assert image.get_extent() == pytest.approx((-1.0, 0.5, 4.0, 5.0))
    assert axes.get_xlim() == pytest.approx((-1.0, 0.5))
    assert axes.get_ylim() == pytest.approx((4.0, 5.0))  # row 0 below
    assert image.origin == "lower"
    assert image.get_clim() == (0.0, 5.0)
    np.testing.assert_array_equal(image.get_array(), cells)
    assert [*axes.get_xticks(), *axes.get_yticks()] == []


@pytest.mark.parametrize("named", [False, True])
def test_the_ends_are_a_dot_and_a_star(named: bool) -> None:
    axes = Figure().add_subplot()
    draw_ends(axes, [1.0, 2.0, 9.0, 9.0], [3.0, 4.0], colours=("red", "blue"), named=named)
    start, goal = axes.lines

    assert (start.get_marker(), start.get_color()) == ("o", "red")
    assert (goal.get_marker(), goal.get_color()) == ("*", "blue")
    assert [np.ravel(line.get_xydata()).tolist() for line in axes.lines] == [[1, 2], [3, 4]]
    assert axes.get_legend_handles_labels()[1] == (["start", "goal"] if named else [])
