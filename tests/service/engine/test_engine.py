"""The engine: the same answer to the last bit, whatever stands beside it."""

from __future__ import annotations

import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_client.contract import AnchorBatch, AnchorRequest, resolve_for_card
from anchorflow_client.errors import InvalidRequest, UnknownModel
from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning
from anchorflow_service.engine.samplers.ode import OdeSampler

Build = Callable[..., AnchorRequest]
AS_SAMPLED = {"smooth": False, "project": False}
ARRAYS = ("trajectories", "velocities", "accelerations", "scores", "clearance", "safe")


def sampler_of(engine: Engine) -> OdeSampler:
    assert isinstance(engine.sampler, OdeSampler)
    return engine.sampler


def plan(engine: Engine, request: AnchorRequest, **how: Any) -> AnchorBatch:
    return engine.plan(resolve_for_card(request, engine.card), **how)


@pytest.fixture
def engine(tiny_bundle: Path) -> Engine:
    return Engine(load_bundle(tiny_bundle), threads=2)


@pytest.fixture
def free(free_bundle: Path) -> Engine:
    """Its anchors have their own durations."""
    return Engine(load_bundle(free_bundle), threads=2)


def assert_same_bytes(batch: AnchorBatch, other: AnchorBatch, *, scene: int | None = None) -> None:
    for name in (*ARRAYS, "durations"):
        array = getattr(other, name)
        array = array if scene is None else array[scene]
        assert getattr(batch, name).tobytes() == array.tobytes(), name


def means_of(folder: Path, request: AnchorRequest, num_samples: int = 20) -> np.ndarray:
    """[N,T,S], the prior's mean of each anchor of a request's only scene."""
    bundle = load_bundle(folder)
    asked = resolve_for_card(request, bundle.card)
    (scene,) = CostMapConditioning(bundle.manifest).scenes(asked)
    routes = scene.scene.route_states
    return routes[np.arange(num_samples) % len(routes)]


def drawn(num_samples: int) -> np.ndarray:
    """Noise of seed 7, [N,3]."""
    generator = np.random.Generator(np.random.PCG64(7))
    return generator.standard_normal((num_samples, 3), dtype=np.float32)


def test_shapes_and_provenance(engine: Engine, small_request: Build) -> None:
    batch = plan(engine, small_request(num_samples=5, request_id="r-1"))
    assert batch.trajectories.shape == batch.accelerations.shape == (5, 8, 2)
    assert batch.scores.shape == batch.safe.shape == (5,)
    assert batch.is_finite
    assert (batch.dt, batch.seed, batch.request_id) == (1.0, 7, "r-1")
    assert batch.model == engine.card.id


def test_both_ends_are_met_after_smoothing(engine: Engine, small_request: Build) -> None:
    batch = plan(engine, small_request(refine={"smooth": True}))
    np.testing.assert_allclose(batch.trajectories[:, 0], [[-3.0, 0.1]] * 20, atol=1e-5)
    np.testing.assert_allclose(batch.trajectories[:, -1], [[3.0, 0.2]] * 20, atol=1e-5)


def test_states_come_as_sampled_where_refinement_is_off(
    tiny_bundle: Path, engine: Engine, small_request: Build
) -> None:
    """The tiny flow adds the channel means, 4 of 256 cells occupied, all passable, no risk, and
    half of its own route's p'; a second is a seventh of the way."""
    noise, request = drawn(20), small_request(refine=AS_SAMPLED)
    mean = means_of(tiny_bundle, request)
    batch = plan(engine, request)
    place = mean[..., :2] + [4 / 256, 1.0] + 0.1 * noise[:, None, :1]
    speed = 1.5 * mean[..., 2:4] + [0.0, 4 / 256] + 0.1 * noise[:, None, 1:2]
    np.testing.assert_allclose(batch.trajectories, place, atol=5e-6)
    np.testing.assert_allclose(batch.velocities, speed / 7.0, atol=5e-6)


def test_each_anchor_lasts_as_long_as_it_was_drawn(
    free_bundle: Path, free: Engine, small_request: Build
) -> None:
    request = small_request(refine=AS_SAMPLED)
    mean = means_of(free_bundle, request)
    batch = plan(free, request)
    expected = np.exp(mean[:, 0, -1] + 0.1 * drawn(20)[:, 2])
    assert isinstance(batch.dt, np.ndarray)
    assert batch.dt.shape == (20,)
    np.testing.assert_allclose(batch.durations, expected, rtol=1e-5)
    np.testing.assert_allclose(batch.dt * 7, batch.durations, rtol=1e-12)
    speed = 1.5 * mean[..., 2:4] + [0.0, 4 / 256] + 0.1 * drawn(20)[:, None, 1:2]
    np.testing.assert_allclose(batch.velocities, speed / expected[:, None, None], atol=1e-5)


def test_with_a_horizon_all_anchors_are_alike(free: Engine, small_request: Build) -> None:
    own, fixed = (plan(free, small_request(horizon_s=h)) for h in (None, 9.1))
    assert len(set(own.durations)) == 20
    assert fixed.dt == pytest.approx(1.3)
    np.testing.assert_allclose(fixed.durations, np.full(20, 9.1))
    assert (fixed.trajectories != own.trajectories).any()


def test_scenes_of_a_batch_have_their_own_durations(free: Engine, small_request: Build) -> None:
    ends = {
        "x_curr": [[-3.0, 0.1] + [0.0] * 4] * 2,
        "x_goal": [[3.0, 0.2, 0, 0], [-1.0, 0.1, 0, 0]],
    }
    batch = plan(free, small_request(**ends))
    assert np.shape(batch.dt) == (2, 20)
    assert (batch.durations[1] < batch.durations[0].min()).all()
    assert np.shape(plan(free, small_request(**ends, horizon_s=6.0)).dt) == ()


@pytest.mark.parametrize(
    "changes",
    [
        {"v_max": 0.26, "a_max": 0.5, "x_curr": [-3.0, 0.1, 0.2, 0.0, 0.0, 0.0]},
        {"v_max": 5.0, "a_max": 6.0},
        {"robot_radius": 0.6},
        {"x_curr": [-3.0, 0.1, 0.0, 1.2, 0.5, -0.5]},
        {"x_goal": [3.0, 0.2, -0.8, 0.6]},
        {"x_goal": [-3.0, 0.1, 0.0, 0.0]},
        {"horizon_s": 30.0},
    ],
    ids=["slow", "fast", "wide", "moving", "passing by", "already there", "in no hurry"],
)
def test_what_a_request_asks_of_its_robot_is_kept(
    free: Engine, small_request: Build, changes: dict[str, Any]
) -> None:
    """Both ends are met exactly, whatever they are; what is called safe keeps the limits asked."""
    request = small_request(refine={"smooth": True, "project": True}, **changes)
    batch = plan(free, request)
    assert batch.is_finite
    ends = np.concatenate([request.x_curr[0], request.x_goal[0]])
    first = (batch.trajectories, batch.velocities, batch.accelerations)
    met = np.concatenate([*(part[:, 0] for part in first), *(part[:, -1] for part in first[:2])], 1)
    np.testing.assert_allclose(met, np.broadcast_to(ends, met.shape), atol=2e-3)
    assert batch.safe.any()
    fastest = np.linalg.norm(batch.velocities[batch.safe], axis=-1).max()
    hardest = np.linalg.norm(batch.accelerations[batch.safe], axis=-1).max()
    assert fastest <= 1.03 * changes.get("v_max", 2.0)
    assert hardest <= 1.06 * changes.get("a_max", 3.0)


def test_a_start_faster_than_the_limit_is_answered_and_none_is_safe(
    free: Engine, small_request: Build
) -> None:
    """The longer an anchor lasted, the further its start would carry it away."""
    batch = plan(free, small_request(v_max=0.26, refine={"smooth": True, "project": True}))
    assert not batch.safe.any()
    assert np.abs(batch.trajectories).max() < 8.0


def test_a_slower_robot_takes_its_time(free: Engine, small_request: Build) -> None:
    slow, usual, fast = (
        plan(free, small_request(v_max=v, a_max=a)).durations.mean()
        for v, a in ((0.26, 0.5), (2.0, 3.0), (5.0, 6.0))
    )
    assert slow > 4 * usual
    assert usual > 1.2 * fast


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"v_max": 9.0}, "expected 0.2 to 6 m/s, for which tiny 1.2.3 was trained, got 9"),
        ({"v_max": 0.1}, "expected 0.2 to 6 m/s"),
        ({"a_max": 9.0}, "expected 0.1 to 8 m/s^2"),
        ({"robot_radius": 0.05}, "expected 0.1 to 0.6 m"),
        ({"horizon_s": 0.5}, "expected 1 to 120 s"),
    ],
)
def test_a_limit_beyond_its_range_is_refused_by_name(
    free: Engine, small_request: Build, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(InvalidRequest, match=re.escape(words)) as caught:
        plan(free, small_request(**changes))
    assert caught.value.field == next(iter(changes))


def walled() -> dict[str, Any]:
    """No way leads from one side to the other."""
    occupancy = np.zeros((1, 16, 16))
    occupancy[0, :, 7:9] = 1.0
    return {"data": occupancy, "resolution": 0.5}


def test_where_no_way_is_free_anchors_are_answered_and_none_is_safe(
    free_bundle: Path, free: Engine, small_request: Build
) -> None:
    request = small_request(cost_map=walled(), refine={"smooth": True, "project": True})
    batch = plan(free, request)
    assert batch.is_finite
    assert not batch.safe.any()
    np.testing.assert_allclose(batch.trajectories[:, -1], [[3.0, 0.2]] * 20, atol=1e-3)
    mean = means_of(free_bundle, request)
    assert (mean == mean[0]).all()


def test_the_first_anchors_of_a_seed_do_not_depend_on_how_many_are_asked_for(
    free: Engine, small_request: Build
) -> None:
    """As they are drawn: what a finish brings back may follow a neighbour that it gained."""
    few, many = (plan(free, small_request(num_samples=n, refine=AS_SAMPLED)) for n in (7, 30))
    np.testing.assert_allclose(few.trajectories, many.trajectories[:7], atol=1e-6)
    np.testing.assert_allclose(few.durations, many.durations[:7], rtol=1e-6)


def test_same_seed_same_bytes_and_another_seed_differs(
    engine: Engine, small_request: Build
) -> None:
    batch = plan(engine, small_request())
    assert_same_bytes(batch, plan(engine, small_request()))
    other = plan(engine, small_request(seed=8))
    assert (batch.trajectories != other.trajectories).any()


def test_a_drawn_seed_is_echoed_and_repeats_the_answer(
    engine: Engine, small_request: Build
) -> None:
    drawn = plan(engine, small_request(seed=None))
    assert_same_bytes(drawn, plan(engine, small_request(seed=drawn.seed)))
    assert plan(engine, small_request(seed=None)).seed != drawn.seed


def scene_fields(index: int) -> dict[str, Any]:
    occupancy = np.zeros((1, 16, 16), np.float32)
    occupancy[0, 4 + index : 6 + index, 6:9] = 1.0
    return {
        "data": occupancy,
        "x_curr": np.array([-3.0, 0.3 * index, 0.2, 0.1, 0.0, 0.0]),
        "x_goal": np.array([3.0, -0.2 * index, 0.1, 0.0]),
        "w_style": np.array([0.5, 0.1 + 0.1 * index, 0.2]),
    }


def test_a_scene_answers_the_same_alone_and_in_a_batch(
    engine: Engine, small_request: Build
) -> None:
    scenes = [scene_fields(index) for index in range(3)]
    stacked = {name: np.stack([scene[name] for scene in scenes]) for name in scenes[0]}
    refine = {"smooth": True, "project": True}

    def ask(fields: dict[str, Any]) -> AnchorBatch:
        cost_map = {"data": fields["data"], "resolution": 0.5}
        rest = {name: fields[name] for name in ("x_curr", "x_goal", "w_style")}
        return plan(engine, small_request(cost_map=cost_map, refine=refine, **rest))

    together = ask(stacked)
    assert together.trajectories.shape == (3, 20, 8, 2)
    for index, scene in enumerate(scenes):
        assert_same_bytes(ask(scene), together, scene=index)


def test_plans_at_once_do_not_touch_each_other(engine: Engine, small_request: Build) -> None:
    requests = [small_request(seed=seed, num_samples=40) for seed in range(6)]
    alone = [plan(engine, request) for request in requests]
    with ThreadPoolExecutor(6) as pool:
        for one, other in zip(alone, pool.map(partial(plan, engine), requests), strict=True):
            assert_same_bytes(one, other)


def test_the_requests_own_sampler_overrides_the_cards(
    tiny_bundle: Path, engine: Engine, small_request: Build
) -> None:
    """Euler in one step sees 4 t³ at t = 0 only: positions stay on their routes, but for noise."""
    sampler = {"method": "euler", "schedule": {"uniform": 1}}
    request = small_request(sampler=sampler, refine=AS_SAMPLED)
    batch = plan(engine, request)
    place = means_of(tiny_bundle, request)[..., :2] + 0.1 * drawn(20)[:, None, :1]
    np.testing.assert_allclose(batch.trajectories, place, atol=2e-6)


def test_stages_make_up_the_total(engine: Engine, small_request: Build) -> None:
    timing = plan(engine, small_request()).timing_ms
    assert list(timing) == ["queue", "encode", "sample", "refine", "total"]
    assert timing["queue"] == 0.0
    assert all(timing[stage] > 0.0 for stage in ("encode", "sample", "refine"))
    assert timing["encode"] + timing["sample"] + timing["refine"] <= timing["total"]


def test_a_wider_robot_has_less_clearance(engine: Engine, small_request: Build) -> None:
    """On the same way, from which the obstacle is too far to bend it: by as much as it is wider."""
    occupancy = np.zeros((1, 16, 16))
    occupancy[0, 12, 8] = 1.0
    aside = {
        "cost_map": {"data": occupancy, "resolution": 0.5},
        "x_curr": [-2.0, 0.1, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [2.0, 0.2, 0.0, 0.0],
        "refine": AS_SAMPLED,
    }
    thin, wide = (
        plan(engine, small_request(robot_radius=radius, **aside)) for radius in (0.4, 0.6)
    )
    np.testing.assert_array_equal(thin.trajectories, wide.trajectories)
    np.testing.assert_allclose(thin.clearance - wide.clearance, 0.2, atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"v_max": 1.0}, "v_max"),
        ({"x_curr": [-3.0, 0.1] + [0.0] * 7, "x_goal": [3.0, 0.2] + [0.0] * 4}, "x_curr"),
        ({"cost_map": {"data": np.zeros((4, 16, 16)), "resolution": 0.5}}, "cost_map.data"),
        (
            {"warm_start": {"trajectory": np.zeros((8, 5)), "tau": 0.5}},
            "warm_start.trajectory",
        ),
    ],
)
def test_what_cannot_be_honoured_is_refused_by_name(
    engine: Engine, small_request: Build, changes: dict[str, Any], field: str
) -> None:
    with pytest.raises(InvalidRequest) as caught:
        plan(engine, small_request(**changes))
    assert caught.value.field == field


def test_another_model_is_unknown(engine: Engine, small_request: Build) -> None:
    with pytest.raises(UnknownModel, match="expected tiny, got huge"):
        plan(engine, small_request(model="huge"))


def ask_in_turn(calls: list[float]) -> Callable[[], None]:
    """A check that counts itself."""
    return lambda: calls.append(0.0)


def test_a_heading_is_answered_between_both_ends(
    turning_bundle: Path, small_request: Build
) -> None:
    engine = Engine(load_bundle(turning_bundle), threads=2)
    start, goal = [-3.0, 0.1, 0.4, 0.5, 0.0, 0.2, 0.0, 0.0, 0.0], [3.0, 0.2, -0.6, 0.0, 0.0, 0.0]
    asked = {"x_curr": start, "x_goal": goal, "refine": {"project": True}}
    batch = plan(engine, small_request(**asked))

    assert batch.trajectories.shape == (20, 8, 3)
    assert batch.safe.any()
    assert len(set(batch.durations)) > 1
    np.testing.assert_allclose(batch.trajectories[:, 0], [start[:3]] * 20, atol=1e-4)
    np.testing.assert_allclose(batch.velocities[:, 0], [start[3:6]] * 20, atol=1e-4)
    np.testing.assert_allclose(batch.trajectories[:, -1], [goal[:3]] * 20, atol=1e-4)
    assert (np.abs(batch.trajectories[..., 2]) < 1.5).all()
    beside = batch.trajectories[:, 3:5, 1]
    assert (beside > 0.4).any()
    assert (beside < -0.4).any()


@pytest.mark.parametrize("cuts_freely", [True, False])
@pytest.mark.parametrize("num_samples", [5, 16, 40])
def test_an_answer_does_not_depend_on_the_threads_that_it_was_given(
    engine: Engine, small_request: Build, cuts_freely: bool, num_samples: int
) -> None:
    """Whether or not this machine's kernels let the engine choose how it cuts."""
    sampler_of(engine).cuts_freely = cuts_freely
    request = small_request(num_samples=num_samples, refine={"smooth": True, "project": True})

    assert_same_bytes(plan(engine, request, threads=1), plan(engine, request, threads=2))


def test_own_durations_are_the_same_alone_in_a_batch_and_on_any_threads(
    free: Engine, small_request: Build
) -> None:
    goals = [[3.0, 0.2, 0.0, 0.0], [-1.0, 2.5, 0.3, 0.0]]
    asked = {"num_samples": 19, "refine": {"smooth": True, "project": True}}
    ends = {"x_curr": [[-3.0, 0.1, 0.5, 0.0, 0.0, 0.0]] * 2, "x_goal": goals}
    together = [plan(free, small_request(**asked, **ends), threads=n) for n in (1, 2)]
    for scene, goal in enumerate(goals):
        alone = plan(free, small_request(**asked, x_goal=goal))
        for batch in together:
            assert_same_bytes(alone, batch, scene=scene)


def test_where_cutting_changes_bytes_one_thread_makes_the_same_cuts(
    engine: Engine, small_request: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    cuts: list[int] = []
    monkeypatch.setattr(
        "anchorflow_service.engine.samplers.ode.integrate",
        lambda _, x, **__: cuts.append(len(x)) or x,
    )
    request, sampler = small_request(num_samples=20), sampler_of(engine)
    for sampler.cuts_freely in (True, False):
        plan(engine, request, threads=1)
        plan(engine, request, threads=2)

    assert cuts[:1] == [20]
    assert sorted(cuts[1:3]) == [10, 10]
    assert cuts[3:5] == [10, 10]
    assert sorted(cuts[5:]) == [10, 10]


@pytest.mark.parametrize("threads", [1, 2])
def test_it_asks_between_the_steps_whether_to_go_on(
    engine: Engine, small_request: Build, threads: int
) -> None:
    """Before each of the two stages, and after each of the two steps of each slice."""
    calls: list[float] = []
    plan(engine, small_request(num_samples=16), threads=threads, check=ask_in_turn(calls))

    assert len(calls) == 2 + 2 * threads


class EnoughError(Exception):
    """No more steps."""


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("allowed", [0, 1, 2, 3])
def test_what_the_check_raises_ends_the_work_at_that_step(
    engine: Engine, small_request: Build, allowed: int, threads: int
) -> None:
    calls: list[float] = []

    def check() -> None:
        calls.append(0.0)
        if len(calls) > allowed:
            raise EnoughError

    with pytest.raises(EnoughError):
        plan(engine, small_request(num_samples=16), threads=threads, check=check)
    assert len(calls) <= allowed + threads  # each slice finds out by itself


def test_an_engine_that_fails_at_its_first_request_is_none(
    tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("Non-zero status code returned while running Gather node")

    monkeypatch.setattr("anchorflow_service.engine.samplers.ode.OdeSampler.integrate", fail)
    with pytest.raises(BundleError, match="the warm-up failed: Non-zero status") as caught:
        Engine(load_bundle(tiny_bundle), threads=1)
    assert caught.value.reason == "bundle: the warm-up failed"
