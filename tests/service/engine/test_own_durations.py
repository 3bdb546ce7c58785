"""Anchors that have their own durations, for robots of other limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asked_engine import AS_SAMPLED, FINISHED, Build, drawn, means_of, plan, walled

from anchorflow_service.engine import Engine


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
    request = small_request(refine=FINISHED, **changes)
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
    batch = plan(free, small_request(v_max=0.26, refine=FINISHED))
    assert not batch.safe.any()
    assert np.abs(batch.trajectories).max() < 8.0


def test_where_no_way_is_free_anchors_are_answered_and_none_is_safe(
    free_bundle: Path, free: Engine, small_request: Build
) -> None:
    request = small_request(cost_map=walled(), refine=FINISHED)
    batch = plan(free, request)
    assert batch.is_finite
    assert not batch.safe.any()
    np.testing.assert_allclose(batch.trajectories[:, -1], [[3.0, 0.2]] * 20, atol=1e-3)
    mean = means_of(free_bundle, request)
    assert (mean == mean[0]).all()
