"""Randomised motion of others: the same places now, other origins."""

from __future__ import annotations

import numpy as np
import pytest
from driven_bend import bend

from anchorflow_client.sensors import LIDAR_BEFORE_S
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.window import PlannerView, Scenes
from anchorflow_training.driving.labels import FASTEST, randomised_motion

VIEWS = [window.view for number in range(3) for window in Scenes(bend(number))]


def test_all_are_where_they_are_and_some_at_other_velocities() -> None:
    changed = 0
    for view in VIEWS:
        made = randomised_motion(view)
        np.testing.assert_array_equal(made.tracks[:, -1, :3], view.tracks[:, -1, :3])
        np.testing.assert_array_equal(made.tracks[view.ego], view.tracks[view.ego])
        changed += not np.array_equal(made.tracks, view.tracks, equal_nan=True)
    assert len(VIEWS) / 3 < changed < len(VIEWS)


@pytest.mark.parametrize("view", VIEWS[:6])
def test_what_was_before_leads_to_what_is_now(view: PlannerView) -> None:
    made = randomised_motion(view).tracks
    then = made.shape[1] - 1 - round(LIDAR_BEFORE_S / FRAME_S)
    others = np.arange(len(made)) != view.ego
    before, now = made[others, then], made[others, -1]
    way, mean = now[:, :2] - before[:, :2], (now[:, 3:] + before[:, 3:]) / 2
    np.testing.assert_allclose(way, LIDAR_BEFORE_S * mean, atol=0.1)
    assert (np.linalg.norm(now[:, 3:], axis=-1) <= FASTEST).all()


def test_the_same_view_gives_the_same() -> None:
    one, other = randomised_motion(VIEWS[0]), randomised_motion(VIEWS[0])
    np.testing.assert_array_equal(one.tracks, other.tracks)
