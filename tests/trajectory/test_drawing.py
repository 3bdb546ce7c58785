"""Drawings of a map, of trajectories and of their ends."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from anchorflow_trajectory.drawing import draw_cells, draw_ends, draw_paths, hide_ticks, sheet


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


def test_paths_are_drawn_without_their_heading() -> None:
    axes = Figure().add_subplot()
    paths = np.arange(24.0).reshape(2, 4, 3)
    lines = draw_paths(axes, paths, ["red", "blue"], linewidths=2.0)

    assert axes.collections[0] is lines
    np.testing.assert_array_equal(np.stack(lines.get_segments()), paths[..., :2])
    assert np.asarray(lines.get_colors()).tolist() == [[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]]
    assert np.asarray(lines.get_linewidth()).tolist() == [2.0]


@pytest.mark.parametrize("named", [False, True])
def test_the_ends_are_a_dot_and_a_star(named: bool) -> None:
    axes = Figure().add_subplot()
    draw_ends(axes, [1.0, 2.0, 9.0, 9.0], [3.0, 4.0], colours=("red", "blue"), named=named)
    start, goal = axes.lines

    assert (start.get_marker(), start.get_color()) == ("o", "red")
    assert (goal.get_marker(), goal.get_color()) == ("*", "blue")
    assert [np.ravel(line.get_xydata()).tolist() for line in axes.lines] == [[1, 2], [3, 4]]
    assert axes.get_legend_handles_labels()[1] == (["start", "goal"] if named else [])


@pytest.mark.parametrize(("count", "rows"), [(1, 1), (4, 1), (5, 2), (9, 3)])
def test_a_sheet_has_a_panel_for_each(count: int, rows: int) -> None:
    figure, panels = sheet(count, columns=4, inches=2.0, header=0.5)

    assert len(panels) == count
    assert all(panel.axison for panel in panels)
    assert [axes for axes in figure.axes if axes.axison] == panels
    assert figure.get_size_inches().tolist() == [2.0 * min(count, 4), 2.0 * rows + 0.5]
