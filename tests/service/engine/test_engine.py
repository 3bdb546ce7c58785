"""The engine over a bundle worked out by hand: what it answers, refuses and asks on the way."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from asked_engine import AS_SAMPLED, Build, drawn, means_of, plan

from anchorflow_client.errors import InvalidRequest, UnknownModel
from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.engine import Engine


def test_shapes_and_provenance(engine: Engine, small_request: Build) -> None:
    batch = plan(engine, small_request(num_samples=5, request_id="r-1"))
    assert batch.trajectories.shape == batch.accelerations.shape == (5, 8, 2)
    assert batch.scores.shape == batch.safe.shape == (5,)
    assert batch.is_finite
    assert (batch.dt, batch.seed, batch.request_id) == (1.0, 7, "r-1")
    assert batch.model == engine.card.id


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


def test_a_part_of_a_warm_starts_vectors_is_refused(engine: Engine, small_request: Build) -> None:
    warm_start = {"trajectory": np.zeros((8, 5)), "tau": 0.5}
    with pytest.raises(InvalidRequest, match="got 5") as caught:
        plan(engine, small_request(warm_start=warm_start))
    assert caught.value.field == "warm_start.trajectory"


def test_another_model_is_unknown(engine: Engine, small_request: Build) -> None:
    with pytest.raises(UnknownModel, match="expected tiny, got huge"):
        plan(engine, small_request(model="huge"))


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


class EnoughError(Exception):
    """No more steps."""


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("allowed", [0, 1, 2, 3, None])
def test_the_check_runs_between_the_steps_and_may_end_the_work(
    engine: Engine, small_request: Build, allowed: int | None, threads: int
) -> None:
    """It runs before each of the two stages, and after each of the two steps of each slice."""
    calls: list[float] = []

    def check() -> None:
        calls.append(0.0)
        if allowed is not None and len(calls) > allowed:
            raise EnoughError

    with nullcontext() if allowed is None else pytest.raises(EnoughError):
        plan(engine, small_request(num_samples=16), threads=threads, check=check)
    if allowed is None:
        assert len(calls) == 2 + 2 * threads
    else:
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
