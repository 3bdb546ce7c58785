"""The bundle that ships: what it is, and that its anchors are worth having."""

from typing import Any

import numpy as np
import pytest

from anchorflow_client.contract import AnchorBatch, AnchorRequest, CostMap, resolve_for_card
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine

MEGABYTE = 2**20
RESOLUTION = 0.1
V_MAX, A_MAX = 2.0, 3.0


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine(load_bundle(DEFAULT_BUNDLE))


def cluttered() -> np.ndarray:
    """[96, 96] occupancy: a wall with two gaps and some posts."""
    occupancy = np.zeros((96, 96), np.float32)
    occupancy[:, 46:50] = 1.0
    occupancy[20:32, 46:50] = occupancy[62:74, 46:50] = 0.0
    for row, column in ((40, 22), (55, 28), (30, 70), (66, 66), (48, 78)):
        occupancy[row : row + 4, column : column + 4] = 1.0
    return occupancy


def plan(engine: Engine, **changes: Any) -> AnchorBatch:
    request: dict[str, Any] = {
        "cost_map": CostMap.build(cluttered()[None], RESOLUTION, None),
        "x_curr": [-4.0, 0.2, 0.5, 0.0, 0.0, 0.0],
        "x_goal": [4.0, -0.2, 0.0, 0.0],
        "seed": 7,
    }
    return engine.plan(resolve_for_card(AnchorRequest.build(**(request | changes)), engine.card))


@pytest.fixture(scope="module")
def anchors(engine: Engine) -> AnchorBatch:
    return plan(engine)


def exact_clearance(path: np.ndarray) -> float:
    """Distance [m] of a polyline to the occupied squares, 0.25 m robot radius taken off."""
    along = np.linspace(0, len(path) - 1, 40 * len(path))
    fine = np.stack([np.interp(along, np.arange(len(path)), path[:, k]) for k in (0, 1)], -1)
    cells = (np.argwhere(cluttered() >= 0.5)[:, ::-1] + 0.5) * RESOLUTION - 4.8
    gap = np.maximum(np.abs(fine[:, None] - cells) - RESOLUTION / 2, 0.0)
    return float(np.hypot(gap[..., 0], gap[..., 1]).min() - 0.25)


def test_it_is_small_enough_to_ship() -> None:
    assert sum(f.stat().st_size for f in DEFAULT_BUNDLE.iterdir()) < 15 * MEGABYTE


def test_its_card_tells_where_it_comes_from(engine: Engine) -> None:
    card = engine.card
    assert (card.T, card.D, card.time.dt, card.cost_map.limits.horizon_s) == (64, 2, None, None)
    assert set(card.cost_map.ranges) == {"v_max", "a_max", "robot_radius", "horizon_s"}
    assert engine.card.training["steps"] >= 1000
    assert engine.card.training["data"]["scenes"] >= 1000
    assert len(engine.card.ode.schedule) == 9


def test_most_anchors_are_safe_and_none_is_called_so_wrongly(anchors: AnchorBatch) -> None:
    assert anchors.safe.mean() > 0.8
    for path in anchors.trajectories[anchors.safe]:
        assert exact_clearance(path) > 0.0


def test_anchors_reach_the_goal_within_the_limits(anchors: AnchorBatch) -> None:
    np.testing.assert_allclose(anchors.trajectories[:, 0], [[-4.0, 0.2]] * 64, atol=1e-3)
    np.testing.assert_allclose(anchors.velocities[:, 0], [[0.5, 0.0]] * 64, atol=1e-3)
    np.testing.assert_allclose(anchors.trajectories[:, -1], [[4.0, -0.2]] * 64, atol=1e-3)
    safe = anchors.safe
    assert np.linalg.norm(anchors.velocities[safe], axis=-1).max() <= 1.03 * V_MAX
    assert np.linalg.norm(anchors.accelerations[safe], axis=-1).max() <= 1.06 * A_MAX


def test_velocity_and_acceleration_belong_to_the_position(anchors: AnchorBatch) -> None:
    inner, dt = slice(1, -1), (anchors.durations / 63)[:, None, None]
    velocity = (np.gradient(anchors.trajectories, axis=1) / dt)[:, inner]
    acceleration = (np.gradient(anchors.velocities, axis=1) / dt)[:, inner]
    assert np.abs(velocity - anchors.velocities[:, inner]).mean() < 0.02
    assert np.abs(acceleration - anchors.accelerations[:, inner]).mean() < 0.1


def test_anchors_last_as_long_as_their_ways_need(anchors: AnchorBatch) -> None:
    steps = np.linalg.norm(np.diff(anchors.trajectories, axis=1), axis=-1)
    least = steps.sum(1) / V_MAX
    safe = anchors.safe
    assert len(np.unique(anchors.durations)) > 32
    assert (anchors.durations[safe] > least[safe]).all()
    assert (anchors.durations[safe] < 6.0 * least[safe]).all()


@pytest.mark.parametrize(("v_max", "a_max"), [(0.26, 0.5), (5.0, 6.0)])
def test_it_plans_for_other_robots(engine: Engine, v_max: float, a_max: float) -> None:
    start = [-4.0, 0.2, 0.0, 0.0, 0.0, 0.0]
    anchors = plan(engine, v_max=v_max, a_max=a_max, x_curr=start)
    safe = anchors.safe
    assert safe.mean() > 0.8
    fastest = np.linalg.norm(anchors.velocities[safe], axis=-1).max(1)
    assert fastest.max() <= 1.03 * v_max
    assert np.linalg.norm(anchors.accelerations[safe], axis=-1).max() <= 1.06 * a_max
    assert np.median(fastest) > 0.3 * min(v_max, 3.0)


def test_with_a_horizon_all_last_as_long_as_it(engine: Engine) -> None:
    anchors = plan(engine, horizon_s=12.0)
    assert anchors.dt == pytest.approx(12.0 / 63)
    assert anchors.safe.mean() > 0.8


def test_anchors_take_both_gaps(anchors: AnchorBatch) -> None:
    at_wall = np.abs(anchors.trajectories[..., 0]).argmin(1)
    heights = anchors.trajectories[np.arange(64), at_wall, 1][anchors.safe]
    assert (heights > 1.0).any()
    assert (heights < -1.0).any()


def test_style_is_followed(engine: Engine) -> None:
    safe, short = (plan(engine, w_style=w) for w in ([0.8, 0.1, 0.1], [0.1, 0.8, 0.1]))

    def length(anchors: AnchorBatch) -> float:
        steps = np.diff(anchors.trajectories[anchors.safe], axis=1)
        return float(np.linalg.norm(steps, axis=-1).sum(1).mean())

    assert safe.clearance[safe.safe].mean() > 1.1 * short.clearance[short.safe].mean()
    assert length(short) < length(safe)


def test_a_scene_answers_the_same_alone_and_in_a_batch(engine: Engine) -> None:
    ends = {
        "x_curr": [[-4.0, 0.2, 0, 0, 0, 0], [-4.0, 2.0, 0, 0, 0, 0]],
        "x_goal": [[4.0, -0.2, 0, 0], [4.0, 1.0, 0, 0]],
    }
    together = plan(engine, num_samples=16, **ends)
    for scene in range(2):
        alone = plan(engine, num_samples=16, **{k: v[scene] for k, v in ends.items()})
        assert alone.trajectories.tobytes() == together.trajectories[scene].tobytes()
        assert alone.scores.tobytes() == together.scores[scene].tobytes()
    again = plan(engine, num_samples=16, **ends)
    assert again.trajectories.tobytes() == together.trajectories.tobytes()


def test_a_robot_beside_an_obstacle_is_answered_and_told(engine: Engine) -> None:
    tight = plan(engine, x_curr=[-0.35, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert not tight.safe.any()
    assert (tight.clearance < 0).all()
