"""Simulated sensors and labels of a window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from driven_bend import bend
from made_nuscenes import add_sensors, recording, write

from anchorflow_driving.drivers import PLAN_TIMES, idm
from anchorflow_driving.importers.nuscenes import import_nuscenes
from anchorflow_driving.log import DRIVEN, write_log
from anchorflow_driving.sensors.inputs import draw_inputs
from anchorflow_driving.sensors.rendering import Renderer, RenderingUnavailable
from anchorflow_driving.window import Scenes
from anchorflow_training.driving import sensor_windows
from anchorflow_training.driving.labels import CLASSES, occupancy, semantic_bev, view_after
from anchorflow_training.driving.sensor_windows import (
    SensorSizes,
    open_sensor_windows,
    reflected,
    sensors_of,
)


def test_semantics_show_the_leader_where_it_is_and_will_be() -> None:
    window = Scenes(bend(0))[0]
    now = semantic_bev(window.view, rows=32, reach=32.0)
    assert now.shape == (32, 64)
    vehicle = CLASSES.index("vehicle")
    rows, columns = np.nonzero(now == vehicle)
    # 20 m before the ego's middle along a bend to the left, 1 m a cell.
    assert 7 <= rows.mean() <= 13
    assert columns.mean() < 31
    assert (now[-1, 30:34] > 0).all()  # the road under the ego
    # It is out of sight after 4 s.
    later = semantic_bev(view_after(window, 4.0), rows=32, reach=32.0)
    assert (later == vehicle).sum() == 0
    still = later == now
    assert still[now != vehicle].all()


def test_occupancy_follows_the_leader_and_leaves_the_ego_out() -> None:
    window = Scenes(bend(0))[0]
    maps = occupancy(window, cells=64, reach=32.0)
    assert maps.shape == (len(PLAN_TIMES), 64, 64)
    assert all(each.any() for each in maps[:2])
    # Row 0 lies farthest ahead.
    ahead = [32 - np.nonzero(each)[0].mean() for each in maps[:2]]
    place = [view_after(window, t).tracks[1, -1, 0] for t in (0.5, 1.0)]
    np.testing.assert_allclose(ahead, place, atol=1.0)
    own = window.recorded(PLAN_TIMES[:1])[0]
    row, column = (np.array([32.0, 32.0]) - own[:2]).astype(int)
    assert not maps[0, row, column]


@pytest.fixture
def _renderer() -> None:
    try:
        Renderer()
    except RenderingUnavailable as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("_renderer")
def test_a_reflected_window_is_the_window_of_the_mirrored_bend() -> None:
    sizes = SensorSizes(64, 256, 256, 32.0)
    own, other = (
        sensor_windows.sensed(Scenes(bend(0, mirrored=mirrored))[0], sizes)
        for mirrored in (False, True)
    )
    seen = reflected(
        {name: array[None] for name, array in own.items()}, pictures=tuple(sizes.shapes)
    )
    for name in ("ego_status", "future", "agents"):
        np.testing.assert_allclose(seen[name][0], other[name], atol=1e-3, err_msg=name)
    for name, most in {"camera": 2.0, "lidar": 0.01, "semantics": 0.05, "occupancy": 0.01}.items():
        unlike, plain = (
            np.abs(drawn.astype(float) - other[name].astype(float)).mean()
            for drawn in (seen[name][0], own[name])
        )
        # Asphalt has another grain there, and edges fall on the other side of a pixel's middle.
        assert unlike < most, name
        assert unlike < 0.35 * plain, name


@pytest.mark.usefixtures("_renderer")
def test_the_simulated_sensors_agree_on_where_the_leader_is() -> None:
    window = Scenes(bend(0))[0]
    told = sensor_windows.sensed(window, SensorSizes(32, 128, 256, 32.0))
    assert told["camera"].shape == (3, 32, 128)
    assert told["camera"].std() > 1  # something is drawn
    assert told["agent_count"] == 1
    vehicle = told["semantics"] == CLASSES.index("vehicle")
    # The histogram begins behind on the right, the semantics ahead on the left.
    struck = told["lidar"][0, ::-1, ::-1][:128] > 0
    rows, columns = np.nonzero(vehicle)
    assert struck.any()
    for row, column in zip(*np.nonzero(struck), strict=True):
        assert np.hypot(rows - row, columns - column).min() <= 2  # half a metre
    x, y = told["agents"][0, :2]
    assert abs(4 * (32 - x) - rows.mean()) < 3
    assert abs(4 * (32 - y) - columns.mean()) < 3


@pytest.mark.usefixtures("_renderer")
def test_a_drive_says_that_it_is_one_and_shows_what_pdm_closed_would_do() -> None:
    log, sizes = bend(0), SensorSizes(32, 128, 256, 32.0)
    recorded, drive = (
        sensor_windows.sensed(Scenes(each)[0], sizes) for each in (log, replace(log, source=DRIVEN))
    )
    assert (recorded["is_example"], recorded["is_recorded"]) == (1, 1)
    assert (drive["is_example"], drive["is_recorded"]) == (1, 0)
    shown = idm(Scenes(log)[0])
    np.testing.assert_allclose(drive["future"], shown, atol=1e-5)
    assert not np.allclose(recorded["future"], shown, atol=0.1)
    aside = log.route_points + np.array([0.0, 9.0], np.float32)
    lost = sensor_windows.sensed(Scenes(replace(log, source=DRIVEN, route_points=aside))[0], sizes)
    assert (lost["is_example"], lost["is_recorded"], lost["future"].any()) == (0, 0, False)


def test_recorded_sensors_are_learnt_from_as_a_driver_is_shown_them(tmp_path: Path) -> None:
    made, sizes = recording(), SensorSizes(32, 128, 256, 32.0, lidar_before=True)
    add_sensors(made["tables"], tmp_path)
    log, _ = import_nuscenes(write(tmp_path, made), sensors=tmp_path)
    write_log(log, tmp_path / "made.npz")

    windows = open_sensor_windows([tmp_path / "made.npz"], sizes)

    batch = windows.batch(np.arange(len(windows)))
    for index, window in enumerate(Scenes(log)):
        shown = draw_inputs(window.view, sizes.inputs)
        for name, array in sensors_of(batch).items():
            np.testing.assert_allclose(array[index], shown[name], atol=1e-6, err_msg=name)
    # Chance moves nobody in what was recorded.
    np.testing.assert_array_equal(batch["lidar_randomised"], batch["lidar_before"])
    np.testing.assert_array_equal(batch["randomised_velocity"], batch["agent_velocity"])
    assert batch["agent_velocity"][:, 0].tolist() == [[pytest.approx(8.0, abs=0.01), 0.0]] * 6
