"""The raster shows the others where they are predicted to be."""

from __future__ import annotations

import numpy as np
import pytest
from driven_bend import bend

from anchorflow_driving.foreseen_bev import foreseen_bev
from anchorflow_driving.futures import RULES, Futures
from anchorflow_driving.sensors.bev import BEV, draw_bev
from anchorflow_driving.sensors.others import others_seen
from anchorflow_driving.window import PlannerView, Scenes

FIRST = BEV.channels.index("occupied_0.5s")


@pytest.fixture
def view() -> PlannerView:
    return Scenes(bend(0))[1].view


def test_constant_velocity_gives_the_raster_as_it_is_drawn(view: PlannerView) -> None:
    futures = RULES["constant_velocity"](view, others_seen(view))
    plain, foreseen = draw_bev(view), foreseen_bev(view, futures)
    np.testing.assert_array_equal(foreseen[:FIRST], plain[:FIRST])
    apart = np.abs(foreseen[FIRST:].astype(int) - plain[FIRST:])
    assert apart.max() < 128  # half a cell, at corners
    areas = foreseen[FIRST:].sum((1, 2), float) / plain[FIRST:].sum((1, 2), float)
    np.testing.assert_allclose(areas, 1.0, atol=0.06)  # Pillow draws some larger


def test_modes_are_drawn_by_their_probabilities_and_nowhere_else(view: PlannerView) -> None:
    poses = np.zeros((48, 2, 8, 3))
    poses[0, 0, :, :2] = 10.25, 5.25  # the middle of a cell
    poses[0, 1, :, :2] = 40.25, -20.25
    probabilities = np.zeros((48, 2))
    probabilities[0] = 0.75, 0.25
    occupied = foreseen_bev(view, Futures(poses, probabilities))[FIRST:]
    for x, y, share in ((10.25, 5.25, 0.75), (40.25, -20.25, 0.25)):
        row, column = int((80.0 - x) / 0.5), int((32.0 - y) / 0.5)
        assert (occupied[:, row, column] == round(255 * share)).all()
        occupied[:, row - 6 : row + 7, column - 4 : column + 5] = 0
    assert not occupied.any()


def test_beyond_the_last_pose_they_go_on(view: PlannerView) -> None:
    poses = np.zeros((48, 1, 8, 3))
    poses[0, 0, :, 0] = 10.25 + 2.0 * np.arange(8)
    probabilities = np.ones((48, 1))
    occupied = foreseen_bev(view, Futures(poses, probabilities))[FIRST:]
    rows = [int((80.0 - x) / 0.5) for x in 10.25 + 2.0 * np.arange(9)]
    column = int(32.0 / 0.5)
    assert [int(occupied[k, row, column]) for k, row in enumerate(rows)] == [255] * 9
    # 4.6 m long: the last box begins 2.3 m behind its middle.
    assert not occupied[8, rows[8] + 6].any()
