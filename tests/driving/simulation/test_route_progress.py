"""Who drives beside a route does not get on along it."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_driving.route import SPACING
from anchorflow_driving.simulation.driven import RouteProgress


def straight(length: float) -> np.ndarray:
    x = np.arange(0.0, length, SPACING)
    return np.stack([x, 0 * x], -1)


def test_who_follows_it_gets_on() -> None:
    progress = RouteProgress(straight(200.0), begin=20.0)
    for x in range(20, 121, 5):
        progress.advance(np.array([x, 3.0]))
    assert (progress.passed, progress.aside, progress.is_lost) == (100.0, 3.0, False)


def test_a_street_beside_it_is_no_part_of_it() -> None:
    progress = RouteProgress(straight(200.0), begin=20.0)
    for x in range(20, 121, 5):
        progress.advance(np.array([x, min(x - 20.0, 40.0)]))
    assert progress.is_lost
    assert progress.passed == pytest.approx(10.0)


def test_a_crossing_with_itself_is_no_short_cut() -> None:
    out, back = straight(100.0), straight(100.0)[::-1] + np.array([0.0, 1.0])
    progress = RouteProgress(np.concatenate([out, back]), begin=20.0)
    progress.advance(np.array([25.0, 0.9]))
    assert progress.passed == pytest.approx(5.0)
