"""The planners without a network."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from anchorflow_benchmarks.baselines import (
    ExpertPlanner,
    LinesPlanner,
    minimum_jerk,
    named_baselines,
)
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judge import SceneJudge
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits

SceneMaker = Callable[..., FamilyScene]


def wall(gap: bool) -> np.ndarray:
    """[64, 64] cells of 0.1 m: a wall across the way, 1.5 m beside which it may be open."""
    occupied = np.zeros((64, 64), bool)
    occupied[:, 31:33] = True
    if gap:
        occupied[42:54, 31:33] = False
    return occupied


def test_minimum_jerk_is_at_rest_at_both_ends() -> None:
    along = minimum_jerk(101)

    assert along[[0, 50, 100]].tolist() == pytest.approx([0.0, 0.5, 1.0])
    assert np.diff(along)[[0, -1]].max() < 1e-4
    assert np.diff(along).max() * 100 == pytest.approx(1.875, abs=1e-3)


@pytest.mark.parametrize("name", ["expert", "lines", "rrt"])
def test_every_baseline_answers_as_many_as_asked_and_reaches_the_goal(
    name: str, scene: SceneMaker, limits: MotionLimits
) -> None:
    if name == "rrt":
        pytest.importorskip("ompl")
    case = scene(wall(gap=True))
    for planner in named_baselines([name], load_bundle(DEFAULT_BUNDLE)):
        anchors = planner.plan(case, num=8, seed=3)
        verdict = SceneJudge(case, limits).judge(anchors)

        assert anchors.positions.shape == (8, 64, 2), planner.name
        assert verdict.reached.all(), planner.name
        assert verdict.coherent.all(), planner.name
        if name != "lines":  # which no refinement brings through the gap
            assert verdict.free.mean() >= 0.5, planner.name


def test_the_same_seed_brings_the_same_anchors(scene: SceneMaker, limits: MotionLimits) -> None:
    case = scene(wall(gap=True))
    for planner in (LinesPlanner(limits), ExpertPlanner(limits, 10)):
        one, same, other = (planner.plan(case, num=8, seed=s).positions for s in (1, 1, 2))
        np.testing.assert_array_equal(one, same)
        assert not np.array_equal(one, other)


def test_where_there_is_no_way_rrt_gives_up(scene: SceneMaker, limits: MotionLimits) -> None:
    pytest.importorskip("ompl")
    from anchorflow_benchmarks.rrt_connect import RrtConnectPlanner

    case = scene(wall(gap=False))
    anchors = RrtConnectPlanner(limits).plan(case, num=16, seed=0)

    assert np.abs(anchors.positions[..., 1]).max() < 1e-4
    assert not SceneJudge(case, limits).judge(anchors).free.any()


def test_an_unknown_baseline_is_refused() -> None:
    with pytest.raises(BenchmarkError, match="'rrrt'"):
        named_baselines(["lines", "rrrt"], load_bundle(DEFAULT_BUNDLE))
