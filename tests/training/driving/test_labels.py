"""Labels and variations of a window: examples, randomised motion, sensor noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from driven_bend import bend

from anchorflow_client.sensors import LIDAR_BEFORE_S
from anchorflow_driving.drivers import PLAN_TIMES, idm
from anchorflow_driving.log import DRIVEN, FRAME_S
from anchorflow_driving.window import PlannerView, Scenes
from anchorflow_models.transfuser import LIDAR_BEFORE
from anchorflow_training.batches import Batch
from anchorflow_training.driving.diffusiondrive_objective import examples
from anchorflow_training.driving.labels import FASTEST, example, randomised_motion
from anchorflow_training.driving.losses import shares
from anchorflow_training.driving.sensor_windows import LIDAR_RANDOMISED, LOST, disturb


def test_what_was_recorded_is_an_example() -> None:
    window = Scenes(bend(0))[0]
    np.testing.assert_array_equal(example(window), window.recorded(PLAN_TIMES))


def test_where_a_planner_drove_pdm_closed_is() -> None:
    window = Scenes(replace(bend(0), source=DRIVEN))[0]
    shown = example(window)
    assert shown is not None
    np.testing.assert_array_equal(shown, idm(window))
    assert not np.allclose(shown, window.recorded(PLAN_TIMES))


def test_whoever_has_left_the_route_shows_nothing() -> None:
    log = bend(0)
    aside = replace(
        log, source=DRIVEN, route_points=log.route_points + np.array([0.0, 9.0], np.float32)
    )
    assert example(Scenes(aside)[0]) is None
    recorded = replace(aside, source=log.source)
    assert example(Scenes(recorded)[0]) is not None


def test_windows_without_an_example_have_no_share() -> None:
    assert shares(torch.tensor([1.0, 0.0, 1.0])).tolist() == [0.5, 0.0, 0.5]
    assert shares(torch.zeros(3)).tolist() == [0.0, 0.0, 0.0]
    batch = {"is_example": torch.tensor([1.0, 0.0, 1.0])}
    at_another_speed = torch.tensor([torch.nan, torch.nan, 4.0])
    assert examples(batch, at_another_speed).tolist() == [1.0, 0.0, 0.0]


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


SWEEPS = ("lidar", LIDAR_BEFORE, LIDAR_RANDOMISED)


def batch() -> Batch:
    return {
        "camera": np.full((40, 3, 16, 32), 120, np.uint8),
        **{name: np.full((40, 1, 32, 32), 0.6, np.float32) for name in SWEEPS},
        "ego_status": np.ones((40, 8), np.float32),
    }


def disturbed(scale: float) -> Batch:
    found = batch()
    disturb(found, np.random.default_rng(0), scale=scale)
    return found


def test_nothing_is_disturbed_by_nothing() -> None:
    for name, array in disturbed(0.0).items():
        np.testing.assert_array_equal(array, batch()[name])


def test_pictures_and_sweeps_are_disturbed_as_much_as_is_asked_for() -> None:
    little, much = disturbed(0.3), disturbed(1.0)
    for found in (little, much):
        assert found["camera"].dtype == np.uint8
        assert found["lidar"].dtype == np.float32
        assert set(np.unique(found["lidar"])) == {np.float32(0.0), np.float32(0.6)}
        np.testing.assert_array_equal(found["ego_status"], batch()["ego_status"])
    spread = [float(each["camera"].std()) for each in (little, much)]
    assert 3.0 < spread[0] < 0.5 * spread[1] < 25.0
    lost = [float((each["lidar"] == 0).mean()) for each in (little, much)]
    np.testing.assert_allclose(lost, [0.3 * LOST / 2, LOST / 2], rtol=0.25)
    # Losses differ by scene, from almost none to almost the maximum.
    by_scene = (much["lidar"] == 0).mean((1, 2, 3))
    assert by_scene.min() < 0.1 * LOST < 0.8 * LOST < by_scene.max()
    assert not np.array_equal(much["lidar"], much[LIDAR_BEFORE])


def test_the_same_luck_disturbs_alike() -> None:
    one, other = disturbed(1.0), disturbed(1.0)
    for name, array in one.items():
        np.testing.assert_array_equal(array, other[name])
