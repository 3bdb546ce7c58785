"""The window of a map that a plan shows to the planner."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_cli.map_window import MARGIN_M, WindowError, map_window
from anchorflow_cli.ros_map import RosMap


def empty_map(*, resolution: float) -> RosMap:
    """60 × 60 m, its corner at the origin."""
    cells = round(60 / resolution)
    return RosMap(
        occupancy=np.zeros((cells, cells), dtype=np.float32),
        unknown=np.zeros((cells, cells), dtype=np.bool_),
        resolution=resolution,
        origin=np.zeros(2),
        unknown_occupancy=1.0,
    )


def test_the_window_holds_both_ends_and_the_margin() -> None:
    start, goal = np.array([20.0, 30.0]), np.array([23.0, 34.0])
    window = map_window(empty_map(resolution=0.1), start, goal, size_m=None)

    side = window.occupancy.shape[0] * window.resolution
    assert window.occupancy.shape == (110, 110)
    for point in (start, goal):
        assert (point >= window.origin + MARGIN_M).all()
        assert (point <= window.origin + side - MARGIN_M).all()


def test_the_window_has_the_side_that_was_asked_for() -> None:
    window = map_window(empty_map(resolution=0.1), np.full(2, 30.0), np.full(2, 32.0), size_m=12.8)

    assert window.occupancy.shape == (128, 128)
    np.testing.assert_allclose(window.origin, 31.0 - 6.4)


def test_the_window_has_the_cells_that_the_contract_wants_at_least() -> None:
    window = map_window(empty_map(resolution=1.0), np.full(2, 30.0), np.full(2, 31.0), size_m=2.0)

    assert window.occupancy.shape == (16, 16)


@pytest.mark.parametrize("size_m", [2.0, float("nan")])
def test_a_window_that_misses_the_ends_is_refused(size_m: float) -> None:
    with pytest.raises(WindowError, match="expected more than 2 m"):
        map_window(empty_map(resolution=0.1), np.full(2, 30.0), np.full(2, 32.0), size_m=size_m)


def test_a_window_with_too_many_cells_is_refused() -> None:
    with pytest.raises(WindowError, match=r"at most 25\.6 m \(512 cells of 0\.05 m\)"):
        map_window(empty_map(resolution=0.05), np.full(2, 5.0), np.full(2, 45.0), size_m=None)
