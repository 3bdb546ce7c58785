"""A request's `refine` on the shipped bundle: guidance, barrier, certified margin."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client.contract import AnchorBatch, AnchorRequest, resolve_for_card
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine

RESOLUTION, RADIUS, SIDE = 0.1, 0.25, 96
# Rows and columns [from, to): a wall with two gaps of 1.2 m, and posts.
WALL = ((0, 20, 46, 50), (32, 62, 46, 50), (74, 96, 46, 50))
POSTS = ((40, 44, 22, 26), (55, 59, 28, 32), (30, 34, 70, 74), (66, 70, 66, 70))
ARRAYS = ("trajectories", "velocities", "accelerations", "scores", "clearance", "safe")
SMOOTHED = {"smooth": True, "project": False}


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine(load_bundle(DEFAULT_BUNDLE), threads=2)


def request(refine: dict[str, Any]) -> AnchorRequest:
    occupancy = np.zeros((1, SIDE, SIDE))
    for top, bottom, left, right in (*WALL, *POSTS):
        occupancy[0, top:bottom, left:right] = 1.0
    return AnchorRequest.build(
        cost_map={"data": occupancy, "resolution": RESOLUTION},
        x_curr=[-4.0, 0.2, 0.5, 0.0, 0.0, 0.0],
        x_goal=[4.0, -0.2, 0.0, 0.0],
        num_samples=64,
        robot_radius=RADIUS,
        seed=1,
        refine=refine,
    )


def plan(engine: Engine, *, threads: int | None = None, **refine: Any) -> AnchorBatch:
    return engine.plan(resolve_for_card(request(refine), engine.card), threads=threads)


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


def assert_same_bytes(one: AnchorBatch, other: AnchorBatch) -> None:
    for name in ARRAYS:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name


def test_guidance_lowers_the_cost_of_what_is_drawn(engine: Engine) -> None:
    """Neither projected nor brought back, so that only the flow can have done it."""
    free, guided = (plan(engine, **SMOOTHED, guidance=scale) for scale in (0.0, 1.0))
    assert (guided.scores > free.scores).mean() > 0.8  # of the same noise
    assert np.mean(guided.scores) > 0.99 * np.mean(free.scores)
    assert guided.safe.mean() > free.safe.mean() + 0.05


def test_the_largest_scale_runs_away_nowhere(engine: Engine) -> None:
    """Without a bound on its steps the flow leaves every map, and the graphs fail."""
    free, guided = (plan(engine, **SMOOTHED, guidance=scale) for scale in (0.0, 100.0))
    assert guided.is_finite
    assert np.median(guided.scores) > np.median(free.scores)


def test_a_scale_of_zero_leaves_the_bytes(engine: Engine) -> None:
    assert_same_bytes(plan(engine, guidance=0.0), plan(engine))


def test_guided_anchors_do_not_depend_on_the_threads(engine: Engine) -> None:
    """Neither on a request's nor on those that the machine has."""
    one, two = (plan(engine, threads=threads, guidance=1.0) for threads in (1, 2))
    assert_same_bytes(one, two)
    for threads in (1, 4):
        assert_same_bytes(
            one, plan(Engine(load_bundle(DEFAULT_BUNDLE), threads=threads), guidance=1.0)
        )


def test_flow_states_are_guided_too(engine: Engine) -> None:
    free, guided = (
        engine.flow_states(resolve_for_card(request({"guidance": g}), engine.card)).positions
        for g in (0.0, 1.0)
    )
    np.testing.assert_array_equal(free[0], guided[0])
    assert np.abs(free[-1] - guided[-1]).max() > 0.01


@pytest.mark.parametrize("barrier", [False, True])
@pytest.mark.parametrize("margin", [0.05, 0.2])
def test_every_safe_anchor_keeps_the_certified_margin(
    engine: Engine, margin: float, barrier: bool
) -> None:
    anchors = plan(engine, certified_margin=margin, barrier=barrier)
    assert anchors.safe.mean() > 0.9
    assert (anchors.clearance[anchors.safe] >= margin).all()
    assert distances(anchors.trajectories[anchors.safe]).min() >= margin


def test_a_margin_that_does_not_fit_is_not_certified(engine: Engine) -> None:
    """The gaps leave 0.35 m."""
    assert not plan(engine, certified_margin=0.4).safe.any()


def test_the_barrier_raises_the_share_that_is_safe(engine: Engine) -> None:
    without, with_barrier = (plan(engine, **SMOOTHED, barrier=b) for b in (False, True))
    assert with_barrier.safe[without.safe].all()
    assert with_barrier.safe.sum() > without.safe.sum()
    np.testing.assert_array_equal(
        with_barrier.trajectories[without.safe], without.trajectories[without.safe]
    )
