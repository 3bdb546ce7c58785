"""Unions of polygons against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_driving.road import DrivableGrid
from anchorflow_driving.simulation.contours import union_rings


def square(x: float, y: float, side: float) -> np.ndarray:
    return np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]])


def area(ring: np.ndarray) -> float:
    x, y = ring.T
    return abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2))


def test_what_overlaps_counts_once() -> None:
    rings = union_rings([square(0, 0, 20), square(10, 0, 20)], level=0.5)

    assert len(rings) == 1
    assert area(rings[0]) == pytest.approx(600.0, abs=2.0)
    held = DrivableGrid(tuple(rings)).holds(np.array([[15.0, 10.0], [29.0, 10.0], [31.0, 10.0]]))
    assert held.tolist() == [True, True, False]


def test_a_sliver_between_two_closes_and_a_hole_stays() -> None:
    frame = [square(0, 0, 30), square(30.005, 0, 30)]

    whole = union_rings(frame, level=0.5)
    holed = union_rings(frame, [square(10, 10, 8)], level=0.5)

    assert len(whole) == 1
    assert sorted(map(area, holed)) == pytest.approx([64.0, 1800.0], rel=0.02)


def test_a_lower_level_lies_outside() -> None:
    (ring,) = union_rings([square(0, 0, 20)], level=0.23)

    assert ring[:, 0].max() == pytest.approx(20.3, abs=0.05)
