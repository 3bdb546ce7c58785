"""The bundle that ships: its card, its anchors, and a request's choices of `refine`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from asked_engine import assert_same_bytes, plan

from anchorflow_client.contract import AnchorBatch, AnchorRequest, resolve_for_card
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine

MEGABYTE = 2**20
RESOLUTION, RADIUS, SIDE = 0.1, 0.25, 96
V_MAX, A_MAX = 2.0, 3.0
# Rows and columns [from, to): a wall with two gaps of 1.2 m, and posts.
WALL = ((0, 20, 46, 50), (32, 62, 46, 50), (74, 96, 46, 50))
POSTS = ((40, 44, 22, 26), (55, 59, 28, 32), (30, 34, 70, 74), (66, 70, 66, 70))
SMOOTHED = {"smooth": True, "project": False}


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine(load_bundle(DEFAULT_BUNDLE), threads=2)


def cluttered(**changes: Any) -> AnchorRequest:
    """Return a request on the map of the wall and the posts."""
    occupancy = np.zeros((1, SIDE, SIDE), np.float32)
    for top, bottom, left, right in (*WALL, *POSTS):
        occupancy[0, top:bottom, left:right] = 1.0
    request = {
        "cost_map": {"data": occupancy, "resolution": RESOLUTION},
        "x_curr": [-4.0, 0.2, 0.5, 0.0, 0.0, 0.0],
        "x_goal": [4.0, -0.2, 0.0, 0.0],
        "robot_radius": RADIUS,
        "seed": 7,
    }
    return AnchorRequest.build(**(request | changes))


def refined(engine: Engine, *, threads: int | None = None, **refine: Any) -> AnchorBatch:
    return plan(engine, cluttered(seed=1, refine=refine), threads=threads)


@pytest.fixture(scope="module")
def anchors(engine: Engine) -> AnchorBatch:
    return plan(engine, cluttered())


def distances(paths: np.ndarray) -> np.ndarray:
    """[M] m from the robot's edge to the nearest rectangle, along polylines [M, T, 2].

    Worked out here, from the rectangles and not from a map.
    """
    boxes = np.array((*WALL, *POSTS)) * RESOLUTION - SIDE * RESOLUTION / 2
    low, high = boxes[:, [2, 0]], boxes[:, [3, 1]]
    along = np.linspace(0.0, 1.0, 40)[:, None, None, None]
    points = paths[:, :-1] + along * np.diff(paths, axis=1)  # [40, M, T-1, 2]
    gaps = [
        np.maximum(np.maximum(a - points, points - b), 0) for a, b in zip(low, high, strict=True)
    ]
    return np.min([np.linalg.norm(gap, axis=-1).min((0, 2)) for gap in gaps], axis=0) - RADIUS


def test_it_is_small_enough_to_ship() -> None:
    assert sum(f.stat().st_size for f in DEFAULT_BUNDLE.iterdir()) < 15 * MEGABYTE


def test_its_card_tells_where_it_comes_from(engine: Engine) -> None:
    card = engine.card
    assert (card.T, card.D, card.time.dt, card.cost_map.limits.horizon_s) == (64, 2, None, None)
    assert set(card.cost_map.ranges) == {"v_max", "a_max", "robot_radius", "horizon_s"}
    assert card.training["steps"] >= 1000
    assert card.training["data"]["scenes"] >= 1000
    assert len(card.ode.schedule) == 9


def test_most_anchors_are_safe_and_none_is_called_so_wrongly(anchors: AnchorBatch) -> None:
    assert anchors.safe.mean() > 0.8
    assert distances(anchors.trajectories[anchors.safe]).min() > 0.0


def test_anchors_meet_both_ends(anchors: AnchorBatch) -> None:
    np.testing.assert_allclose(anchors.trajectories[:, 0], [[-4.0, 0.2]] * 64, atol=1e-3)
    np.testing.assert_allclose(anchors.velocities[:, 0], [[0.5, 0.0]] * 64, atol=1e-3)
    np.testing.assert_allclose(anchors.trajectories[:, -1], [[4.0, -0.2]] * 64, atol=1e-3)


def test_velocity_and_acceleration_belong_to_the_position(anchors: AnchorBatch) -> None:
    inner, dt = slice(1, -1), (anchors.durations / 63)[:, None, None]
    velocity = (np.gradient(anchors.trajectories, axis=1) / dt)[:, inner]
    acceleration = (np.gradient(anchors.velocities, axis=1) / dt)[:, inner]
    assert np.abs(velocity - anchors.velocities[:, inner]).mean() < 0.02
    assert np.abs(acceleration - anchors.accelerations[:, inner]).mean() < 0.1


def lengths(anchors: AnchorBatch) -> np.ndarray:
    return np.linalg.norm(np.diff(anchors.trajectories, axis=1), axis=-1).sum(1)


def test_anchors_last_as_long_as_their_ways_need(anchors: AnchorBatch) -> None:
    share = (anchors.durations / (lengths(anchors) / V_MAX))[anchors.safe]
    assert len(np.unique(anchors.durations)) > 32
    assert (share > 1.0).all()
    assert (share < 6.0).all()


@pytest.mark.parametrize(("v_max", "a_max"), [(0.26, 0.5), (V_MAX, A_MAX), (5.0, 6.0)])
def test_it_plans_within_each_robots_limits(engine: Engine, v_max: float, a_max: float) -> None:
    start = [-4.0, 0.2, 0.0, 0.0, 0.0, 0.0]
    anchors = plan(engine, cluttered(v_max=v_max, a_max=a_max, x_curr=start))
    safe = anchors.safe
    assert safe.mean() > 0.8
    fastest = np.linalg.norm(anchors.velocities[safe], axis=-1).max(1)
    assert fastest.max() <= 1.03 * v_max
    assert np.linalg.norm(anchors.accelerations[safe], axis=-1).max() <= 1.06 * a_max
    assert np.median(fastest) > 0.3 * min(v_max, 3.0)


def test_anchors_take_both_gaps(anchors: AnchorBatch) -> None:
    at_wall = np.abs(anchors.trajectories[..., 0]).argmin(1)
    heights = anchors.trajectories[np.arange(64), at_wall, 1][anchors.safe]
    assert (heights > 1.0).any()
    assert (heights < -1.0).any()


def test_style_is_followed(engine: Engine) -> None:
    styles = [0.8, 0.1, 0.1], [0.1, 0.8, 0.1]
    safe, short = (plan(engine, cluttered(w_style=style)) for style in styles)
    assert safe.clearance[safe.safe].mean() > 1.1 * short.clearance[short.safe].mean()
    assert lengths(short)[short.safe].mean() < lengths(safe)[safe.safe].mean()


def test_a_robot_beside_an_obstacle_is_answered_and_told(engine: Engine) -> None:
    tight = plan(engine, cluttered(x_curr=[-0.35, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert not tight.safe.any()
    assert (tight.clearance < 0).all()


def test_guidance_lowers_the_cost_of_what_is_drawn(engine: Engine) -> None:
    """Neither projected nor brought back, so that only the flow can have done it."""
    free, guided, far = (refined(engine, **SMOOTHED, guidance=g) for g in (0.0, 1.0, 100.0))
    assert (guided.scores > free.scores).mean() > 0.8  # of the same noise
    assert np.mean(guided.scores) > 0.99 * np.mean(free.scores)
    assert guided.safe.mean() > free.safe.mean() + 0.05
    # Without a bound on its steps the flow leaves every map, and the graphs fail.
    assert far.is_finite
    assert np.median(far.scores) > np.median(free.scores)


def test_a_scale_of_zero_leaves_the_bytes(engine: Engine) -> None:
    assert_same_bytes(refined(engine, guidance=0.0), refined(engine))


def test_guided_anchors_do_not_depend_on_the_threads(engine: Engine) -> None:
    """Neither on a request's nor on those that the machine has."""
    one, two = (refined(engine, threads=threads, guidance=1.0) for threads in (1, 2))
    assert_same_bytes(one, two)
    for threads in (1, 4):
        other = Engine(load_bundle(DEFAULT_BUNDLE), threads=threads)
        assert_same_bytes(one, refined(other, guidance=1.0))


def test_flow_states_are_guided_too(engine: Engine) -> None:
    requests = [cluttered(seed=1, refine={"guidance": scale}) for scale in (0.0, 1.0)]
    free, guided = (
        engine.flow_states(resolve_for_card(request, engine.card)).positions for request in requests
    )
    np.testing.assert_array_equal(free[0], guided[0])
    assert np.abs(free[-1] - guided[-1]).max() > 0.01


@pytest.mark.parametrize("barrier", [False, True])
@pytest.mark.parametrize("margin", [0.05, 0.2])
def test_every_safe_anchor_keeps_the_certified_margin(
    engine: Engine, margin: float, barrier: bool
) -> None:
    anchors = refined(engine, certified_margin=margin, barrier=barrier)
    assert anchors.safe.mean() > 0.9
    assert (anchors.clearance[anchors.safe] >= margin).all()
    assert distances(anchors.trajectories[anchors.safe]).min() >= margin


def test_a_margin_that_does_not_fit_is_not_certified(engine: Engine) -> None:
    """The gaps leave 0.35 m."""
    assert not refined(engine, certified_margin=0.4).safe.any()


def test_the_barrier_raises_the_share_that_is_safe(engine: Engine) -> None:
    without, with_barrier = (refined(engine, **SMOOTHED, barrier=b) for b in (False, True))
    assert with_barrier.safe[without.safe].all()
    assert with_barrier.safe.sum() > without.safe.sum()
    np.testing.assert_array_equal(
        with_barrier.trajectories[without.safe], without.trajectories[without.safe]
    )


def test_raw_positions_are_the_samples_before_the_finish(engine: Engine) -> None:
    """In the request's frame; the trajectories beside them are what they are without."""
    request = cluttered(outputs=["raw_positions"])
    both = plan(engine, request)
    assert_same_bytes(both, plan(engine, cluttered()))
    (drawn,) = engine.samples(resolve_for_card(request, engine.card))
    raw = both.arrays["raw_positions"]
    np.testing.assert_array_equal(raw, drawn.states[..., :2])
    moved = np.linalg.norm(raw - both.trajectories, axis=-1)
    assert 0.01 < moved.mean() < 1.0
    body = {
        "kinematics": {"kind": "differential"},
        "x_curr": [-4.0, *[0.0] * 8],
        "x_goal": [4.0, *[0.0] * 5],
    }
    with pytest.raises(InvalidRequest, match="expected no raw_positions: poses of a body"):
        plan(engine, cluttered(outputs=["raw_positions"], **body))
