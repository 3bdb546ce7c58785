"""Windows of a made-up bend, kept beside their log, and what augmentation makes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from driven_bend import SPEED, bend

from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.sensors.bev import BEV, draw_bev
from anchorflow_driving.sensors.inputs import status_of
from anchorflow_driving.window import Scenes
from anchorflow_training.driving import augmentation
from anchorflow_training.driving.anchors import clustered, read_goals, read_points
from anchorflow_training.driving.augmentation import AugmentationConfig, disturbed, poses_on
from anchorflow_training.driving.windows import SPACING, DrivingWindows
from anchorflow_training.settings import ConfigError


def test_what_is_kept_is_what_a_planner_is_shown(windows: DrivingWindows) -> None:
    scenes = Scenes(bend(0))

    assert len(windows) == 2 * len(scenes)
    for index in (0, len(scenes) - 1):
        view = scenes[index].view
        np.testing.assert_array_equal(windows.rasters([index])[0], draw_bev(view))
        np.testing.assert_array_equal(windows.status[index], status_of(view))
        np.testing.assert_allclose(windows.size[index], view.vehicle.size)
    assert windows.log.tolist() == [0] * len(scenes) + [1] * len(scenes)


def test_the_course_is_what_was_driven(windows: DrivingWindows) -> None:
    driven = Scenes(bend(0))[0].recorded(PLAN_TIMES)
    course, along = windows.course[0].astype(float), windows.along[0].astype(float)

    np.testing.assert_allclose(along, SPEED * PLAN_TIMES, rtol=0.01)
    np.testing.assert_allclose(poses_on(course, along)[:, :2], driven[:, :2], atol=0.06)
    np.testing.assert_allclose(poses_on(course, along)[:, 2], driven[:, 2], atol=0.03)
    # It follows the route evenly beyond the record.
    np.testing.assert_allclose(np.linalg.norm(np.diff(course, axis=0), axis=1), SPACING, rtol=0.05)


def test_a_mirrored_window_is_the_window_of_the_mirrored_bend(windows: DrivingWindows) -> None:
    bev = windows.rasters([0])[0]
    status, course = windows.status[0].copy(), windows.course[0].copy()
    augmentation.mirror(bev, status, course)
    view = Scenes(bend(0, mirrored=True))[0].view

    np.testing.assert_allclose(status, status_of(view), atol=1e-4)
    there = draw_bev(view).astype(int)
    # Edges fall on the other side of a cell's middle.
    assert np.abs(bev.astype(int) - there).mean() < 1.0
    left = BEV.channels.index("lanes_left")
    assert abs(int(bev[left].sum()) - int(there[left].sum())) < 0.05 * there[left].sum() + 1


def test_a_disturbed_start_rejoins() -> None:
    course = np.stack([SPACING * np.arange(73), np.zeros(73)], -1).astype(np.float64)
    moved = np.array([0.0, 0.5, 0.1])
    seen = disturbed(course, moved, speed=8.0)

    np.testing.assert_allclose(seen[0], 0.0, atol=1e-9)
    assert abs(poses_on(seen, np.array([0.0]))[0, 2]) < 0.02
    cos, sin = np.cos(0.1), np.sin(0.1)
    back = np.stack([cos * seen[:, 0] - sin * seen[:, 1], sin * seen[:, 0] + cos * seen[:, 1]], -1)
    np.testing.assert_allclose(np.add(back, (0.0, 0.5))[20:], course[20:], atol=1e-9)


def test_a_faster_start_ends_where_it_was() -> None:
    along = np.array([8.0 * PLAN_TIMES])
    faster = augmentation.rejoined(along, np.array([1.0]), PLAN_TIMES)

    assert faster[0, 0] > along[0, 0] + 0.3
    assert faster[0, -1] == pytest.approx(along[0, -1])


def test_retimed_targets_begin_at_their_speed_and_never_reverse() -> None:
    rng = np.random.default_rng(0)
    ways = augmentation.retimed(
        np.array([0.0, 8.0]), AugmentationConfig(), PLAN_TIMES, count=50, rng=rng
    )

    assert ways.shape == (2, 50, 8)
    assert (np.diff(ways, axis=-1) >= -1e-9).all()
    assert (ways >= 0).all()
    assert np.abs(ways[1, :, 0] - 4.0).max() < 0.5


def test_a_vocabulary_of_the_ends() -> None:
    ends = np.repeat([[10.0, 0.0], [30.0, 5.0], [2.0, 0.0]], 20, axis=0)
    found = clustered(
        ends + 0.01 * np.random.default_rng(0).normal(size=ends.shape), count=3, seed=0
    )
    np.testing.assert_allclose(found, [[2, 0], [10, 0], [30, 5]], atol=0.05)


def test_a_vocabulary_of_a_grid() -> None:
    goals = read_goals("grid:2,62,-16,16", 512)
    assert goals.shape == (512, 2)
    assert (goals.min(0).tolist(), goals.max(0).tolist()) == ([2, -16], [62, 16])
    apart = np.linalg.norm(goals[:, None] - goals, axis=-1) + 99 * np.eye(512)
    assert np.ptp(apart.min(0)) < 0.1  # as far from each other everywhere
    for wrong in ("grid:2,62", "grid:9,2,0,1", "grid:a,b,c,d"):
        with pytest.raises(ConfigError, match=r"vocabulary: expected grid:X0,X1,Y0,Y1"):
            read_goals(wrong, 8)


@pytest.mark.parametrize(("setting", "shape"), [("vocabulary", (3, 2)), ("anchors", (3, 8, 3))])
def test_points_of_ones_own_are_read_or_refused(
    setting: str, shape: tuple[int, ...], tmp_path: Path
) -> None:
    points, file = (
        np.random.default_rng(0).normal(size=shape).astype(np.float32),
        tmp_path / "own.npy",
    )
    np.save(file, points)
    np.testing.assert_array_equal(read_points(file, shape, setting=setting), points)
    more = (shape[0] + 1, *shape[1:])
    expected = f"{setting}: .*own.npy: expected shape {[*more]}, got {[*shape]}"
    with pytest.raises(ConfigError, match=expected.replace("[", r"\[").replace("]", r"\]")):
        read_points(file, more, setting=setting)
    whole = file.read_bytes()
    for damaged in (b"", whole[:-1], whole.replace(b")", b" ")):
        file.write_bytes(damaged)
        with pytest.raises(ConfigError, match=f"{setting}: .*own.npy: "):
            read_points(file, shape, setting=setting)
