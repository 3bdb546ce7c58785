"""The judge against closed forms, and against the judges outside the project."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.baselines import RoutesPlanner
from anchorflow_benchmarks.grid_path import grid_path
from anchorflow_benchmarks.judge import (
    SceneJudge,
    count_classes,
    duplicate_share,
    least_duration,
    swept_angles,
)
from anchorflow_benchmarks.planners import Proposals, limits_of
from anchorflow_benchmarks.scene_files import load_routes, load_scenes, read_routes
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.bundle.entries import SplineEntry
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.spline.basis import spline_basis

SceneMaker = Callable[..., FamilyScene]
Tools = Callable[[str], ModuleType]


def random_anchors(scene: FamilyScene, *, count: int, seed: int, size: float) -> Proposals:
    """Splines from the scene's start to its goal, bent by about `size` m in each direction."""
    basis, rng = spline_basis(64), np.random.default_rng(seed)
    splines = basis.rest_curves(scene.ends, np.full(count, 8.0))
    free = splines.control[..., basis.free]
    free += rng.normal(0.0, size, (2, count, 1)) * np.sin(np.linspace(0.0, np.pi, free.shape[-1]))
    free += rng.normal(0.0, 0.05 * size, free.shape)
    return Proposals.of_spline(basis, splines)


def bows(scene: FamilyScene, *heights: float) -> Proposals:
    """An anchor for each height [m] at which it passes the middle."""
    basis = spline_basis(64)
    splines = basis.rest_curves(scene.ends, np.full(len(heights), 8.0))
    side = splines.control[1, :, basis.free]
    bow = np.sin(np.linspace(0.0, np.pi, side.shape[1]))
    side += np.array(heights, np.float32)[:, None] * bow
    return Proposals.of_spline(basis, splines)


def arguments(plan: Proposals, case: FamilyScene) -> tuple[Any, ...]:
    """Return what the judge outside the project takes."""
    states = (plan.positions, plan.velocities, plan.accelerations)
    of_map = (case.occupied, case.resolution)
    return (*states, plan.dt, *of_map, case.x_curr, case.x_goal, case.robot_radius)


@pytest.mark.parametrize("seed", range(3))
def test_it_agrees_with_the_judge_outside_the_project(
    seed: int, scene: SceneMaker, limits: MotionLimits, shared_tool: Tools
) -> None:
    rng = np.random.default_rng(seed)
    occupied = rng.random((40, 40)) < [0.004, 0.008, 0.014][seed % 3]
    occupied[18:22, 5:12] = occupied[18:22, 28:36] = False
    case = scene(occupied)
    plan = random_anchors(case, count=48, seed=seed, size=[0.4, 1.2][seed % 2])
    # Some that break each rule by itself.
    position, velocity, acceleration = (
        a.copy() for a in (plan.positions, plan.velocities, plan.accelerations)
    )
    position[0] += 0.08
    velocity[1] *= 1.1
    acceleration[2] += 0.5
    acceleration[3, 30] = 4.0
    position[4] *= 1.7
    # Each in a time of its own.
    slower = rng.uniform(0.9, 1.6, (48, 1, 1))
    plan = Proposals(
        position,
        velocity / slower,
        acceleration / slower**2,
        plan.dt * slower.ravel(),
    )

    verdict = SceneJudge(case, limits).judge(plan)
    expected = shared_tool("score_anchors").score_scene(*arguments(plan, case), timing=True)

    assert verdict.success.any()
    verdict.measures["lasts"] = verdict.measures["duration"]
    for name, value in expected.items():
        np.testing.assert_allclose(verdict.measures[name], value, rtol=0, atol=1e-9, err_msg=name)


def test_a_straight_way_past_nothing_succeeds(scene: SceneMaker, limits: MotionLimits) -> None:
    case = scene(np.zeros((32, 32), bool))
    verdict = SceneJudge(case, limits).judge(bows(case, 0.0))

    assert verdict.success.all()
    assert verdict.measures["classes"] == 1.0
    assert verdict.measures["length"] == pytest.approx(1.0, abs=0.02)
    assert np.isnan(verdict.measures["unsafe_called_safe"])


def test_clearance_is_measured_to_the_square_of_a_cell(
    scene: SceneMaker, limits: MotionLimits
) -> None:
    occupied = np.zeros((64, 64), bool)  # cells of 0.1 m
    occupied[37, 32] = True  # 0.5 m above the straight way

    clearance = SceneJudge(scene(occupied), limits).clearance(np.array([[[-2.0, 0], [2.0, 0]]]))

    # The field knows a distance to half a subcell.
    assert clearance[0] == pytest.approx(0.5 - 0.25, abs=0.5 * 0.1 / 4 + 1e-9)


@pytest.mark.parametrize(
    ("length", "seconds"),
    [
        (4.0, 4.0 / 2.0 + 2.0 / 3.0),  # a trapezoid of speed
        (0.75, 2.0 * np.sqrt(0.75 / 3.0)),  # a triangle
        (4.0 / 3.0, 4.0 / 3.0),  # the limit between both
    ],
)
def test_the_least_duration_is_from_rest_to_rest(
    length: float, seconds: float, limits: MotionLimits
) -> None:
    assert least_duration(length, limits) == pytest.approx(seconds)


def test_haste_is_the_quickest_successs(scene: SceneMaker, limits: MotionLimits) -> None:
    case = scene(np.zeros((32, 32), bool))
    one = bows(case, 0.0)
    factors = np.array([1.0, 2.0, 0.25])  # the last breaks the limits
    stretch = factors[:, None, None]
    three = Proposals(
        np.repeat(one.positions, 3, axis=0),
        one.velocities / stretch,
        one.accelerations / stretch**2,
        one.dts * factors,
    )
    verdict = SceneJudge(case, limits).judge(three)

    assert verdict.success.tolist() == [True, True, False]
    assert verdict.duration == pytest.approx(8.0 * factors)
    assert verdict.measures["duration"] == pytest.approx(12.0)
    assert verdict.measures["haste"] == pytest.approx(8.0 / least_duration(4.0, limits), rel=0.02)


def test_a_promise_that_does_not_hold_is_counted(scene: SceneMaker, limits: MotionLimits) -> None:
    occupied = np.zeros((64, 64), bool)
    occupied[30:34, 30:34] = True
    case = scene(occupied)
    one = bows(case, 0.0)

    for safe, count in ((True, 1.0), (False, 0.0)):
        measures = SceneJudge(case, limits).judge(replace(one, safe=np.array([safe]))).measures
        assert measures["unsafe_called_safe"] == count
        assert measures["free"] == 0.0


def test_a_path_off_the_map_is_not_free(scene: SceneMaker, limits: MotionLimits) -> None:
    judge = SceneJudge(scene(np.zeros((32, 32), bool)), limits)

    assert judge.clearance(np.array([[[-2.0, 0], [0, 3.3], [2.0, 0]]])) < 0
    assert judge.clearance(np.array([[[-2.0, 0], [0, 3.2], [2.0, 0]]])) > 0


def test_ways_on_both_sides_are_two_classes() -> None:
    left, right = ([[-2.0, 0], [0, y], [2.0, 0]] for y in (1.0, -1.0))
    paths = np.array([left, right, left])

    np.testing.assert_allclose(swept_angles(paths, np.zeros((1, 2)))[:, 0], [-np.pi, np.pi, -np.pi])
    assert count_classes(paths, np.zeros((1, 2))) == 2
    assert count_classes(paths, np.empty((0, 2))) == 1


def test_duplicates_are_two_centimetres_apart() -> None:
    path = np.zeros((4, 64, 2))
    path[1] += 0.0139  # 1.97 cm
    path[2] += 1.0
    path[3] += 1.0145  # 2.05 cm from the one before

    assert duplicate_share(path) == 0.5
    assert duplicate_share(path[:1]) == 0.0


def test_the_shortest_way_goes_round() -> None:
    passable = np.ones((9, 9), bool)
    assert grid_path(passable, (4, 0), (4, 8))[0] == 8.0
    passable[:, 4:6] = False  # two cells thick: a move of two cells does not cross it
    assert np.isnan(grid_path(passable, (4, 0), (4, 8))[0])
    passable[8, 4:6] = True
    assert 8.0 < grid_path(passable, (4, 0), (4, 8))[0] < 8.0 + 2 * 4


def post(offset: int = 0) -> np.ndarray:
    """[64, 64] cells of 0.1 m with a post of four, `offset` cells above the straight way."""
    occupied = np.zeros((64, 64), bool)
    occupied[31 + offset : 33 + offset, 31:33] = True
    return occupied


def test_ways_on_one_side_are_one_of_two_routes(scene: SceneMaker, limits: MotionLimits) -> None:
    case = scene(post(offset=1))  # so the way below it is the shortest
    measures = {
        heights: SceneJudge(case, limits).judge(bows(case, *heights)).measures
        for heights in ((0.9, 1.2), (-0.7,), (0.9, -0.7), (0.0,))
    }

    found = {h: tuple(m[n] for n in ("recall", "first", "found")) for h, m in measures.items()}
    assert found == {
        (0.9, 1.2): (0.5, 0.0, 1.0),
        (-0.7,): (0.5, 1.0, 1.0),
        (0.9, -0.7): (1.0, 1.0, 2.0),
        (0.0,): (0.0, 0.0, 0.0),
    }
    assert measures[(0.9, -0.7)]["duration"] == pytest.approx(8.0)
    assert np.isnan(measures[(0.0,)]["duration"])


def test_known_routes_are_counted_in_place_of_searched_ones(
    scene: SceneMaker, limits: MotionLimits
) -> None:
    case = scene(post())
    judge = SceneJudge(case, limits, [(1,), (7,), (8,), (9,)])
    measures = judge.judge(bows(case, 0.9, -0.9)).measures

    assert judge.judge(bows(case, 0.9)).routes == 4
    assert (measures["recall"], measures["first"], measures["found"]) == (0.25, 1.0, 2.0)


def test_a_scene_without_a_route_counts_nowhere(scene: SceneMaker, limits: MotionLimits) -> None:
    wall = np.zeros((64, 64), bool)
    wall[:, 32] = True
    case = scene(wall)
    verdict = SceneJudge(case, limits).judge(bows(case, 0.0))

    assert verdict.routes == 0
    assert np.isnan([verdict.measures[n] for n in ("recall", "first", "found", "distinct")]).all()


def test_a_file_of_routes_is_read_scene_by_scene(tmp_path: Path) -> None:
    path = tmp_path / "routes.npz"
    arrays = {
        "count": np.array([2, 0, 1]),
        "size": np.array([2, 2, 1]),
        "signature": np.array([0, 1, -1, 0, 2], np.int8),
    }
    np.savez(path, allow_pickle=False, **arrays)

    assert read_routes(path) == [[(0, 1), (-1, 0)], [], [(2,)]]
    assert load_routes(path, scenes=2, limit=2) == [[(0, 1), (-1, 0)], [(2,)]]
    with pytest.raises(BenchmarkError, match="expected the routes of 4 scenes, got 3"):
        load_routes(path, scenes=4)
    for broken, said in (
        (arrays | {"size": arrays["size"][:2]}, "its counts do not add up"),
        ({"count": arrays["count"]}, "expected the key 'size', found count"),
    ):
        np.savez(path, allow_pickle=False, **broken)
        with pytest.raises(BenchmarkError, match=rf"routes\.npz: not a file of routes \({said}"):
            read_routes(path)


@pytest.mark.parametrize(
    ("scenes", "routes"),
    [
        ("scenes_public.npz", "routes_public.npz"),
        ("forests_public.npz", "forest_routes_public.npz"),
    ],
)
def test_routes_agree_with_the_judge_outside_the_project(
    scenes: str, routes: str, shared_data: Callable[[str], Path], shared_tool: Tools
) -> None:
    outside = shared_tool("routes")
    bundle = load_bundle(DEFAULT_BUNDLE)
    limits, finish = limits_of(bundle), bundle.manifest.finish
    assert isinstance(finish, SplineEntry)
    planner = RoutesPlanner(limits, finish, descents=5)
    cases = load_scenes(str(shared_data(scenes)), limits=limits, limit=4)
    known = load_routes(shared_data(routes), scenes=4, limit=4)
    whole = outside.read_routes(shared_data(routes))
    spread = [whole[i] for i in np.linspace(0, len(whole) - 1, 4).astype(int)]
    judged = 0
    for case, signatures, listed in zip(cases, known, spread, strict=True):
        assert signatures == [signature for signature, _ in listed]
        if not listed:
            continue
        judged += 1
        plan = planner.plan(case, num=24, seed=5)
        good = outside.successes(*arguments(plan, case))
        expected = outside.score_routes(
            plan.positions, good, case.occupied, case.resolution, case.robot_radius, listed
        )
        measures = SceneJudge(case, limits, signatures).judge(plan).measures
        names = ("recall", "first", "found", "distinct")
        assert [measures[n] for n in names] == [expected[n] for n in names]
        assert measures["success"] == good.mean()
    assert judged >= 2


def test_the_search_finds_the_routes_of_the_judge_outside_the_project(
    limits: MotionLimits, shared_data: Callable[[str], Path]
) -> None:
    cases = load_scenes(str(shared_data("forests_public.npz")), limits=limits, limit=5)
    known = load_routes(shared_data("forest_routes_public.npz"), scenes=5, limit=5)

    for case, listed in zip(cases, known, strict=True):
        assert set(SceneJudge(case, limits).listed_routes) == set(listed)
