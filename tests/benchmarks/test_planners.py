"""Bundles, samplers and the planners without a network."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from image_planner import write_image_bundle

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.baselines import (
    ExpertPlanner,
    LinesPlanner,
    named_baselines,
)
from anchorflow_benchmarks.judge import SceneJudge
from anchorflow_benchmarks.planners import (
    bundle_names,
    evaluations,
    open_bundle,
    parse_sampler,
    sampler_name,
)
from anchorflow_client.contract import ModelCard
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits

SceneMaker = Callable[..., FamilyScene]


def test_a_planner_without_a_cost_map_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match=r"tiny-camera: .*got conditioning 'tensors'.*judge"):
        open_bundle(write_image_bundle(tmp_path))


def test_bundles_are_told_apart_by_as_much_of_their_path_as_it_takes(tmp_path: Path) -> None:
    for folder in ("first/same", "second/same", "another"):
        shutil.copytree(DEFAULT_BUNDLE, tmp_path / folder)
    same, again, another = (
        open_bundle(tmp_path / folder) for folder in ("first/same", "second/same", "another")
    )
    assert bundle_names([same]) == ["flowmp-small"]
    assert bundle_names([same, another]) == ["flowmp-small (same)", "flowmp-small (another)"]
    assert bundle_names([same, again]) == [
        f"flowmp-small ({tmp_path}/first/same)",
        f"flowmp-small ({tmp_path}/second/same)",
    ]


@pytest.fixture(scope="module")
def card() -> ModelCard:
    return load_bundle(DEFAULT_BUNDLE).card


@pytest.mark.parametrize(
    ("name", "cost"),
    [("rk4:8step", 32), ("rk4:uniform8", 32), ("midpoint:uniform2", 4), ("euler:uniform1", 1)],
)
def test_a_name_and_its_cost(name: str, cost: int, card: ModelCard) -> None:
    sampler = parse_sampler(name, card)

    assert sampler_name(sampler) == name
    assert evaluations(sampler) == cost
    assert parse_sampler("card", card) == card.sampler


@pytest.mark.parametrize("text", ["rk4", "rk5:8step", "rk4:9step", "rk4:uniform0", "", "rk4:"])
def test_an_unknown_one_is_refused(text: str, card: ModelCard) -> None:
    with pytest.raises(BenchmarkError, match="sampler"):
        parse_sampler(text, card)


def wall(gap: bool) -> np.ndarray:
    """[64, 64] cells of 0.1 m: a wall across the way, 1.5 m beside which it may be open."""
    occupied = np.zeros((64, 64), bool)
    occupied[:, 31:33] = True
    if gap:
        occupied[42:54, 31:33] = False
    return occupied


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
