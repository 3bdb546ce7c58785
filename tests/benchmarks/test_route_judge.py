"""Routes taken: closed forms, files of routes, and the judge that stands outside the project."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judge import SceneJudge
from anchorflow_benchmarks.planners import limits_of
from anchorflow_benchmarks.route_files import load_routes, read_routes
from anchorflow_benchmarks.route_judge import count_distinct
from anchorflow_benchmarks.routes_planner import RoutesPlanner
from anchorflow_benchmarks.scene_files import load_scenes
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.bundle.manifest import SplineEntry
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.spline import spline_basis

SceneMaker = Callable[..., FamilyScene]


@pytest.fixture(scope="session")
def shared_route_judge(shared_judge: ModuleType, request: pytest.FixtureRequest) -> ModuleType:
    """The judge of routes beside the checkout, which imports the one of anchors by its name."""
    path = request.config.rootpath.parent / "shared" / "tools" / "routes.py"
    if not path.exists():
        pytest.skip(f"the shared judge {path.name} is not in {path.parent}")
    spec = importlib.util.spec_from_file_location("shared_route_judge", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "score_anchors", shared_judge)
        patch.setattr(sys, "path", sys.path.copy())
        spec.loader.exec_module(module)
    return module


def post(offset: int = 0) -> np.ndarray:
    """[64, 64] cells of 0.1 m with a post of four, `offset` cells above the straight way."""
    occupied = np.zeros((64, 64), bool)
    occupied[31 + offset : 33 + offset, 31:33] = True
    return occupied


def bows(scene: FamilyScene, *heights: float) -> Proposals:
    """An anchor for each height [m] at which it passes the middle."""
    basis = spline_basis(64)
    splines = basis.rest_curves(scene.ends, np.full(len(heights), 8.0))
    side = splines.control[1, :, basis.free]
    bow = np.sin(np.linspace(0.0, np.pi, side.shape[1]))
    side += np.array(heights, np.float32)[:, None] * bow
    return Proposals.of_spline(basis, splines)


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


def test_of_two_near_ones_the_later_is_dropped() -> None:
    paths = np.zeros((5, 64, 2))
    paths[:, :, 1] = np.array([0.0, 0.09, 0.18, 0.11, 0.29])[:, None]

    assert count_distinct(paths) == 3  # 0, 0.18, 0.29: each is compared with those kept alone
    assert count_distinct(paths[:0]) == 0


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
def test_it_agrees_with_the_judge_outside_the_project(
    scenes: str,
    routes: str,
    shared_data: Callable[[str], Path],
    shared_route_judge: ModuleType,
) -> None:
    bundle = load_bundle(DEFAULT_BUNDLE)
    limits, finish = limits_of(bundle), bundle.manifest.finish
    assert isinstance(finish, SplineEntry)
    planner = RoutesPlanner(limits, finish, descents=5)
    cases = load_scenes(str(shared_data(scenes)), limits=limits, limit=6)
    known = load_routes(shared_data(routes), scenes=6, limit=6)
    whole = shared_route_judge.read_routes(shared_data(routes))
    spread = [whole[i] for i in np.linspace(0, len(whole) - 1, 6).astype(int)]
    judged = 0
    for case, signatures, listed in zip(cases, known, spread, strict=True):
        assert signatures == [signature for signature, _ in listed]
        if not listed:
            continue
        judged += 1
        plan = planner.plan(case, num=24, seed=5)
        good = shared_route_judge.successes(
            plan.positions,
            plan.velocities,
            plan.accelerations,
            plan.dt,
            case.occupied,
            case.resolution,
            case.x_curr,
            case.x_goal,
            case.robot_radius,
        )
        expected = shared_route_judge.score_routes(
            plan.positions, good, case.occupied, case.resolution, case.robot_radius, listed
        )
        measures = SceneJudge(case, limits, signatures).judge(plan).measures
        names = ("recall", "first", "found", "distinct")
        assert [measures[n] for n in names] == [expected[n] for n in names]
        assert measures["success"] == good.mean()
    assert judged >= 4


def test_the_search_finds_the_routes_of_the_judge_outside_the_project(
    limits: MotionLimits, shared_data: Callable[[str], Path]
) -> None:
    cases = load_scenes(str(shared_data("forests_public.npz")), limits=limits, limit=9)
    known = load_routes(shared_data("forest_routes_public.npz"), scenes=9, limit=9)

    for case, listed in zip(cases, known, strict=True):
        assert set(SceneJudge(case, limits).of_routes.listed) == set(listed)
