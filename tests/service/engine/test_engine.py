"""The engine: the same answer to the last bit, whatever stands beside it."""

from __future__ import annotations

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


def assert_same_bytes(batch: AnchorBatch, other: AnchorBatch, *, scene: int | None = None) -> None:
    for name in ARRAYS:
        array = getattr(other, name)
        array = array if scene is None else array[scene]
        assert getattr(batch, name).tobytes() == array.tobytes(), name


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
    engine: Engine, small_request: Build
) -> None:
    """The tiny flow adds the channel means: 4 of 256 cells occupied, all passable, no risk."""
    noise = np.random.Generator(np.random.PCG64(7)).standard_normal((20, 2), dtype=np.float32)
    batch = plan(engine, small_request(refine=AS_SAMPLED))
    start = np.array([-3.0 + 4 / 256, 0.1 + 1.0]) + 0.1 * noise[:, :1]
    np.testing.assert_allclose(batch.trajectories[:, 3], start, atol=2e-6)
    np.testing.assert_allclose(
        batch.velocities[:, 3], np.array([0.5, 4 / 256]) + 0.1 * noise[:, 1:], atol=2e-6
    )


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


def test_the_requests_own_sampler_overrides_the_cards(engine: Engine, small_request: Build) -> None:
    """Euler in one step sees 4 t³ at t = 0 only: nothing moves."""
    sampler = {"method": "euler", "schedule": {"uniform": 1}}
    x_curr = [-3.0, 0.1, 0.5, 0.0, 0.25, 0.0]
    batch = plan(engine, small_request(sampler=sampler, refine=AS_SAMPLED, x_curr=x_curr))
    np.testing.assert_array_equal(batch.accelerations, np.full((20, 8, 2), [0.25, 0.0]))


def test_stages_make_up_the_total(engine: Engine, small_request: Build) -> None:
    timing = plan(engine, small_request()).timing_ms
    assert list(timing) == ["queue", "encode", "sample", "refine", "total"]
    assert timing["queue"] == 0.0
    assert all(timing[stage] > 0.0 for stage in ("encode", "sample", "refine"))
    assert timing["encode"] + timing["sample"] + timing["refine"] <= timing["total"]


def test_a_wider_robot_has_less_clearance(engine: Engine, small_request: Build) -> None:
    """The radius is adjustable on this card; it moves the clearance and nothing of the sample."""
    thin, wide = (
        plan(engine, small_request(robot_radius=radius, refine=AS_SAMPLED)) for radius in (0.1, 0.4)
    )
    np.testing.assert_array_equal(thin.trajectories, wide.trajectories)
    assert (thin.clearance >= wide.clearance).all()


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


@pytest.mark.parametrize("cuts_freely", [True, False])
@pytest.mark.parametrize("num_samples", [5, 16, 40])
def test_an_answer_does_not_depend_on_the_threads_that_it_was_given(
    engine: Engine, small_request: Build, cuts_freely: bool, num_samples: int
) -> None:
    """Whether or not this machine's kernels let the engine choose how it cuts."""
    sampler_of(engine).cuts_freely = cuts_freely
    request = small_request(num_samples=num_samples, refine={"smooth": True, "project": True})

    assert_same_bytes(plan(engine, request, threads=1), plan(engine, request, threads=2))


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
