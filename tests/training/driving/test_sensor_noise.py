"""Noise on pictures and sweeps: as configured, and on nothing else."""

from __future__ import annotations

import numpy as np

from anchorflow_models.transfuser import LIDAR_BEFORE
from anchorflow_training.batches import Batch
from anchorflow_training.driving.sensor_windows import LIDAR_RANDOMISED, LOST, disturb

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
