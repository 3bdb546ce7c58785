"""The same answer to the last bit, whatever else is planned at the time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from asked_engine import AS_SAMPLED, FINISHED, Build, assert_same_at_once, assert_same_bytes, plan

from anchorflow_client.contract import AnchorBatch
from anchorflow_service.engine import Engine
from anchorflow_service.engine.samplers.ode import OdeSampler


def sampler_of(engine: Engine) -> OdeSampler:
    assert isinstance(engine.sampler, OdeSampler)
    return engine.sampler


@pytest.mark.parametrize("num_samples", [1, 7, 8, 9])
def test_the_first_anchors_of_a_seed_do_not_depend_on_how_many_are_asked_for(
    free: Engine, small_request: Build, num_samples: int
) -> None:
    """As they are drawn: what a finish brings back may follow a neighbour that it gained."""
    few, many = (
        plan(free, small_request(num_samples=n, refine=AS_SAMPLED)) for n in (num_samples, 31)
    )
    np.testing.assert_allclose(few.trajectories, many.trajectories[:num_samples], atol=1e-6)
    np.testing.assert_allclose(few.durations, many.durations[:num_samples], rtol=1e-6)


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


def test_a_scene_answers_the_same_alone_and_in_a_batch(free: Engine, small_request: Build) -> None:
    maps = np.zeros((3, 1, 16, 16), np.float32)
    for index, occupancy in enumerate(maps):
        occupancy[0, 4 + index : 6 + index, 6:9] = 1.0
    stacked = {
        "x_curr": [[-3.0, 0.3 * index, 0.2, 0.1, 0.0, 0.0] for index in range(3)],
        "x_goal": [[3.0, -0.2 * index, 0.1, 0.0] for index in range(3)],
        "w_style": [[0.5, 0.1 + 0.1 * index, 0.2] for index in range(3)],
    }

    def ask(data: np.ndarray, fields: dict[str, Any]) -> AnchorBatch:
        cost_map = {"data": data, "resolution": 0.5}
        return plan(free, small_request(cost_map=cost_map, refine=FINISHED, **fields))

    together = ask(maps, stacked)
    assert together.trajectories.shape == (3, 20, 8, 2)
    for index, data in enumerate(maps):
        own = {name: each[index] for name, each in stacked.items()}
        assert_same_bytes(ask(data, own), together, scene=index)


def test_plans_at_once_do_not_touch_each_other(engine: Engine, small_request: Build) -> None:
    assert_same_at_once(engine, [small_request(seed=seed, num_samples=40) for seed in range(6)])


@pytest.mark.parametrize("cuts_freely", [True, False])
@pytest.mark.parametrize("num_samples", [5, 16, 40])
def test_an_answer_does_not_depend_on_the_threads_that_it_was_given(
    free: Engine, small_request: Build, cuts_freely: bool, num_samples: int
) -> None:
    """Whether or not this machine's kernels let the engine choose how it cuts."""
    sampler_of(free).cuts_freely = cuts_freely
    request = small_request(num_samples=num_samples, refine=FINISHED)
    assert_same_bytes(plan(free, request, threads=1), plan(free, request, threads=2))


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
