"""Evasive manoeuvres: they begin as told, keep the limits, and end apart from each other."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_trajectory.finish.certificate import ACCELERATION_TOLERANCE, SPEED_TOLERANCE
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.evasions import evasions
from anchorflow_trajectory.spline.basis import Ends, spline_basis

BASIS = spline_basis(64).finer
MOVING = np.array([1.0, 2.0, 1.8, 0.3, 0.0, -1.0])


@pytest.mark.parametrize("horizon_s", [None, 1.2, 4.0])
@pytest.mark.parametrize("start", [MOVING, np.zeros(6)], ids=["moving", "at rest"])
def test_they_begin_as_told_and_keep_the_limits(start: np.ndarray, horizon_s: float | None) -> None:
    assert BASIS is not None
    limits = MotionLimits(2.0, 2.0, horizon_s)
    drawn = evasions(BASIS, Ends(start, np.array([5.0, 5.0, 0.0, 0.0])), limits)
    position, velocity, acceleration = BASIS.states(drawn)
    assert np.abs(position[:, 0] - start[:2]).max() < 1e-4
    assert np.abs(velocity[:, 0] - start[2:4]).max() < 1e-3
    assert np.linalg.norm(velocity, axis=-1).max() <= SPEED_TOLERANCE * 2.0
    pull = np.linalg.norm(acceleration, axis=-1).max(1)
    assert (pull <= ACCELERATION_TOLERANCE * 2.0).mean() > 0.9
    # Harder than a smooth curve can: at the limit from the first moment.
    assert np.median(np.linalg.norm(acceleration[:, 0], axis=-1)) > 1.5


def test_the_first_brakes_straight_on_and_the_others_go_to_all_sides() -> None:
    assert BASIS is not None
    drawn = evasions(BASIS, Ends(MOVING, np.zeros(4)), MotionLimits(2.0, 2.0, 4.0))
    position, velocity, _ = BASIS.states(drawn)
    speed = np.linalg.norm(MOVING[2:4])
    way = position[0] - MOVING[:2]
    ahead, aside = way @ MOVING[2:4] / speed, way @ [-0.3, 1.8] / speed
    assert np.abs(aside).max() < 0.01
    assert ahead[-1] == pytest.approx(speed**2 / (2 * 0.94 * 2.0), abs=0.05)
    assert np.abs(velocity[0, -1]).max() < 1e-3
    later = position[:, 16] - MOVING[:2] - MOVING[2:4] * drawn.duration[:, None] * 16 / 63
    sides = np.arctan2(*later.T)
    assert len(np.unique(np.round(sides / (np.pi / 4)))) >= 8
