"""The same scenes, asked as other robots would."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anchorflow_benchmarks.planners import engine_planners, limits_of
from anchorflow_benchmarks.robot_quality import (
    RADII,
    SPEEDS,
    AskedRobot,
    is_open,
    robot_tables,
)
from anchorflow_client import InvalidRequest
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits

SceneMaker = Callable[..., FamilyScene]


@pytest.fixture
def any_robot() -> Bundle:
    """The default bundle, whose card lets every robot ask."""
    return load_bundle(DEFAULT_BUNDLE)


@pytest.fixture
def one_robot(tmp_path: Path) -> Bundle:
    """The same, for no robot but its own."""
    folder = tmp_path / "bundle"
    shutil.copytree(DEFAULT_BUNDLE, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["conditioning"]["ranges"] = {"horizon_s": [1.0, 60.0]}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return load_bundle(folder)


def gap(scene: SceneMaker, cells: int) -> FamilyScene:
    """6.4 m with a wall across, open for so many cells of 0.1 m in its middle."""
    occupied = np.zeros((64, 64), bool)
    occupied[:, 31:33] = True
    occupied[32 - cells // 2 : 32 + cells // 2, 31:33] = False
    return scene(occupied)


def test_a_slower_robot_starts_slower(scene: SceneMaker, limits: MotionLimits) -> None:
    moving = replace(
        scene(np.zeros((32, 32), bool)),
        x_curr=np.array([-2, 0, 1.0, 0.5, 0.6, 0.3], np.float32),
        x_goal=np.array([2, 0, 0.5, 0.0], np.float32),
    )
    slow = AskedRobot(v_max=0.5, a_max=1.0, radius=0.4).scene(moving, limits)
    fast = AskedRobot(v_max=5.0).scene(moving, limits)

    assert slow.x_curr == pytest.approx([-2, 0, 0.25, 0.125, 0.2, 0.1])
    assert slow.x_goal == pytest.approx([2, 0, 0.125, 0.0])
    assert (slow.robot_radius, fast.robot_radius) == (0.4, 0.25)
    assert fast.x_curr == pytest.approx(moving.x_curr)
    assert AskedRobot(v_max=5.0).limits(limits) == replace(limits, v_max=5.0)


@pytest.mark.parametrize(("radius", "open_"), [(0.25, True), (0.45, True), (0.6, False)])
def test_a_way_is_open_for_a_robot_that_fits(
    radius: float, open_: bool, scene: SceneMaker, limits: MotionLimits
) -> None:
    met = AskedRobot(radius=radius).scene(gap(scene, 10), limits)

    assert is_open(met) is open_


def test_an_end_too_near_to_something_is_not_open(scene: SceneMaker, limits: MotionLimits) -> None:
    occupied = np.zeros((64, 64), bool)
    occupied[36, 12] = True  # 0.35 m above the start
    near = scene(occupied)

    assert is_open(AskedRobot(radius=0.25).scene(near, limits))
    assert not is_open(AskedRobot(radius=0.4).scene(near, limits))


def test_a_row_a_robot(any_robot: Bundle, scene: SceneMaker) -> None:
    planners = engine_planners([any_robot], ["euler:uniform1"], threads=1)
    done: list[int] = []
    scenes = [gap(scene, 10), gap(scene, 20)]
    speeds, radii = robot_tables(
        planners, scenes, own=limits_of(any_robot), num=4, progress=done.append
    )

    assert [(row["v_max"], row["a_max"]) for row in speeds.rows] == list(SPEEDS)
    assert [row["radius"] for row in radii.rows] == list(RADII)
    assert [row["scenes"] for row in radii.rows] == [2, 2, 2, 2, 1, 1]
    assert sum(done) == 2 * (len(SPEEDS) + len(RADII))
    own = speeds.rows[2]
    assert own["success"] == 1.0
    assert float(own["haste"] or 0.0) >= 1.0
    slow = speeds.rows[0]  # takes its time
    assert slow["success"] == 1.0
    assert float(slow["duration"] or 0.0) > 4.0 / 0.26
    assert all(row["unsafe_called_safe"] == 0 for row in (*speeds.rows, *radii.rows))


def test_a_card_without_the_range_refuses(one_robot: Bundle, scene: SceneMaker) -> None:
    planners = engine_planners([one_robot], ["euler:uniform1"], threads=1)
    with pytest.raises(InvalidRequest, match="v_max"):
        robot_tables(planners, [gap(scene, 20)], own=limits_of(one_robot), num=2)
