"""Comfort is judged from a drive's first step to its last."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_driving.pdm.lqr_rollout import Motion
from anchorflow_driving.simulation.driven import (
    QUANTITIES,
    comfortable_stretches,
    first_steps,
    joined,
)


def braking(seconds: float, *, since: float) -> Motion:
    """Straight on at 20 m/s, and from a time on with 9 m/s²."""
    time = np.arange(round(seconds * 10) + 1) / 10
    acceleration = np.where(time >= since, -9.0, 0.0)[None]
    speed = np.maximum(20.0 + 0.1 * np.cumsum(acceleration, 1), 0.0)
    x = 0.1 * np.cumsum(speed, 1)
    return Motion(np.stack([x, 0 * x, 0 * x], -1), speed, acceleration, 0 * speed)


@pytest.mark.parametrize(
    ("seconds", "since", "wanted"),
    [
        (4.0, 9.0, [True]),
        (4.0, 0.0, [False]),
        (8.0, 4.5, [True, False]),
        (9.0, 8.0, [True, True, False]),
        (3.9, 0.0, []),
    ],
)
def test_stretches(seconds: float, since: float, wanted: list[bool]) -> None:
    assert comfortable_stretches(braking(seconds, since=since)) == wanted


def test_motions_join_where_one_ends_and_the_next_begins() -> None:
    whole = braking(2.0, since=1.0)
    parts = [Motion(*(getattr(whole, name)[:, 5 * k :] for name in QUANTITIES)) for k in range(4)]
    again = joined([first_steps(part, 5) for part in parts])
    np.testing.assert_array_equal(again.poses, whole.poses)
    np.testing.assert_array_equal(again.speed, whole.speed)
