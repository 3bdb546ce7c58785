"""The finish: what `safe` certifies, what a failed anchor is helped by, and on which way."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from anchorflow_trajectory.finish.refined import Refined
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import Ends, Splines, spline_basis

BASIS = spline_basis(64)
LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
RESOLUTION, RADIUS = 0.1, 0.25
X_CURR = np.asarray([0.8, 3.2, 0.3, 0.0, 0.0, 0.0], np.float32)
X_GOAL = np.asarray([5.6, 3.2, 0.0, 0.0], np.float32)
STYLE = np.asarray([0.0, 1.0, 0.0], np.float32)  # energy: as near to obstacles as it may
UNFINISHED = {"smooth": False, "project": False}


@dataclass(frozen=True)
class Spec:
    """The finish options of a request."""

    smooth: bool = True
    project: bool = True
    safety_margin: float = 0.1
    barrier: bool = False
    certified_margin: float = 0.0


POSTS = ((10, 22), (32, 38), (54, 60))  # rows; gaps of 1.0 and 1.6 m between them
COLUMNS = (30, 34)


def occupied() -> np.ndarray:
    cells = np.zeros((64, 64), bool)
    for low, high in POSTS:
        cells[low:high, slice(*COLUMNS)] = True
    return cells


def scene_of(
    *, x_curr: np.ndarray = X_CURR, x_goal: np.ndarray = X_GOAL, motion: MotionLimits = LIMITS
) -> Scene:
    return Scene(
        cost_map=occupied()[None].astype(np.float32),
        resolution=RESOLUTION,
        origin=np.zeros(2),
        robot_radius=RADIUS,
        x_curr=x_curr,
        x_goal=x_goal,
        w_style=STYLE,
        motion=motion,
        basis=BASIS,
    )


def curves(scene: Scene, duration: float) -> Splines:
    """64 disturbed ones, from 2 m below the axis to 2.5 m above it."""
    rng = np.random.default_rng(3)
    splines = BASIS.rest_curves(scene.ends, duration * np.exp(rng.normal(0.0, 0.1, 64)))
    free = splines.control[..., BASIS.free]
    free += rng.normal(0, 0.15, free.shape) * np.sin(np.linspace(0, np.pi, free.shape[-1]))
    free[1] += np.linspace(-2.0, 2.5, 64)[:, None] * np.sin(np.linspace(0, np.pi, free.shape[-1]))
    return splines


def states_of(splines: Splines) -> np.ndarray:
    lasting = np.broadcast_to(np.log(splines.duration)[:, None, None], (len(splines), 64, 1))
    return np.concatenate([BASIS.own_time_states(splines.control), lasting], axis=-1)


def refined(
    scene: Scene | None = None,
    *,
    steps: int = 20,
    duration: float = 8.0,
    route: np.ndarray | None = None,
    **spec: Any,
) -> Refined:
    """64 disturbed curves finished, all on one route by default."""
    scene = scene or scene_of()
    route = np.zeros(64, int) if route is None else route
    return Refiner(scene, steps).refine(states_of(curves(scene, duration)), route, Spec(**spec))


def distances(positions: np.ndarray) -> np.ndarray:
    """[M] m from the robot's edge to the nearest post, every 2 mm along each polyline.

    To the posts as rectangles, so without the project's own fields.
    """
    low = RESOLUTION * np.array([(COLUMNS[0], rows[0]) for rows in POSTS])
    high = RESOLUTION * np.array([(COLUMNS[1], rows[1]) for rows in POSTS])
    least = []
    for path in positions.astype(np.float64):
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        at = np.linspace(0.0, along[-1], int(along[-1] / 0.002) + 2)
        points = np.stack([np.interp(at, along, path[:, k]) for k in (0, 1)], -1)[:, None]
        gap = np.maximum(np.maximum(low - points, points - high), 0.0)
        least.append(np.linalg.norm(gap, axis=-1).min() - RADIUS)
    return np.array(least)


@pytest.mark.parametrize("margin", [0.0, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("barrier", [False, True])
def test_what_is_safe_keeps_the_certified_margin(margin: float, barrier: bool) -> None:
    anchors = refined(certified_margin=margin, barrier=barrier)
    assert anchors.safe.mean() > 0.9
    assert (anchors.clearance[anchors.safe] >= margin).all()
    assert distances(anchors.positions[anchors.safe]).min() >= margin


@pytest.mark.parametrize(
    ("safety_margin", "certified_margin", "aim"),
    [(0.1, 0.0, 0.1), (0.0, 0.0, 0.0), (0.1, 0.2, 0.3), (0.0, 0.2, 0.3), (0.5, 0.2, 0.5)],
)
def test_the_descent_aims_beyond_what_is_certified(
    safety_margin: float, certified_margin: float, aim: float
) -> None:
    spec = Spec(safety_margin=safety_margin, certified_margin=certified_margin)
    assert Refiner(scene_of(), 20).cost(spec).margin == pytest.approx(aim, abs=1e-12)


def test_where_an_end_is_too_near_no_anchor_is_safe_and_none_is_worse() -> None:
    """The start is 0.15 m from a post; the projection runs without a certified margin."""
    near = np.asarray([2.6, 3.5, 0.0, 0.0, 0.0, 0.0], np.float32)
    scene = scene_of(x_curr=near)
    asked, plain = (refined(scene, steps=1, certified_margin=m) for m in (0.3, 0.0))
    assert not asked.safe.any()
    assert plain.safe.mean() > 0.9
    assert (asked.clearance >= 0.03).mean() > 0.9  # far fewer, were the margin insisted on


def test_the_barrier_takes_no_safe_anchor_away_and_brings_more() -> None:
    """Without descents, which would leave it little to do."""
    without, with_barrier = (refined(project=False, barrier=b) for b in (False, True))
    assert with_barrier.safe[without.safe].all()
    # Safe anchors stay, and so do those that the barrier could not make safe.
    left = without.safe | ~with_barrier.safe
    np.testing.assert_array_equal(with_barrier.positions[left], without.positions[left])
    assert with_barrier.safe.mean() > without.safe.mean() + 0.1


@pytest.mark.parametrize("spec", [{}, {"smooth": True, "project": False}, {"barrier": True}])
def test_both_ends_are_met_exactly_whatever_the_duration(spec: dict[str, Any]) -> None:
    ends = Ends(np.array([0.8, 3.2, 0.6, 0.2, 0.3, -0.2]), np.array([5.6, 3.2, 0.4, -0.1]))
    anchors = refined(scene_of(x_curr=ends.x_curr, x_goal=ends.x_goal), duration=4.0, **spec)
    assert np.ptp(anchors.duration) > 0.1
    states = anchors.positions, anchors.velocities, anchors.accelerations
    start = np.concatenate([x[:, 0] for x in states], -1)
    goal = np.concatenate([x[:, -1] for x in states[:2]], -1)
    np.testing.assert_allclose(start, np.tile(ends.x_curr, (64, 1)), atol=3e-4)
    np.testing.assert_allclose(goal, np.tile(ends.x_goal, (64, 1)), atol=3e-5)


def test_neither_smoothed_nor_projected_anchors_are_as_they_were_sampled() -> None:
    scene = scene_of()
    splines = curves(scene, 6.0)
    states = states_of(splines) + 0.01 * np.random.default_rng(1).normal(size=(64, 64, 7))
    sampled = Refiner(scene, 20).refine(states, np.zeros(64, int), Spec(**UNFINISHED))
    duration = np.exp(states[..., -1].mean(1))
    np.testing.assert_allclose(sampled.duration, duration, rtol=1e-6)
    for order, found in enumerate((sampled.positions, sampled.velocities, sampled.accelerations)):
        expected = states[..., 2 * order : 2 * order + 2] / duration[:, None, None] ** order
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_sampled_anchors_are_safe_only_as_one_motion_from_start_to_goal() -> None:
    """The sampled derivatives and the sampled start have had no other check."""
    scene = scene_of()
    states = states_of(scene.route_splines[:1])
    no_slower, elsewhere = states.copy(), states.copy()
    no_slower[..., 2:6] *= 0.5  # told of half its own pace
    no_slower[..., -1] -= np.log(2.0)
    elsewhere[..., 0, 1] += 0.2
    told = np.concatenate([states, no_slower, elsewhere])
    sampled = Refiner(scene, 20).refine(told, np.zeros(3, int), Spec(**UNFINISHED))
    speed = np.linalg.norm(sampled.velocities, axis=-1).max(1)
    assert (speed <= 1.02 * LIMITS.v_max).all()
    assert sampled.safe.tolist() == [True, False, False]


def test_what_is_sampled_for_a_horizon_lasts_as_long() -> None:
    fixed = scene_of(motion=replace(LIMITS, horizon_s=7.0))
    for spec in ({}, {"project": False}, UNFINISHED):
        assert set(refined(fixed, duration=5.0, **dict[str, Any](spec)).duration) == {7.0}


def test_a_duration_that_is_too_short_is_stretched_and_one_that_is_too_long_shortened() -> None:
    hasty, slow = (refined(duration=d) for d in (1.2, 16.0))
    assert np.median(hasty.duration) > 2.0
    assert np.median(slow.duration) < 12.0
    for anchors in (hasty, slow):
        assert anchors.safe.mean() > 0.9
        speed = np.linalg.norm(anchors.velocities[anchors.safe], axis=-1)
        assert speed.max() <= 1.02 * LIMITS.v_max


@pytest.mark.parametrize("steps", [1, 10])
def test_what_is_too_fast_is_stretched_where_descents_do_not_suffice(steps: int) -> None:
    """And on one way only as far as it takes: not one anchor is safe without."""
    anchors = refined(duration=1.2, steps=steps)
    assert anchors.safe.mean() > 0.9
    assert np.median(anchors.duration) < 6.0


def places(scene: Scene, anchors: Refined) -> np.ndarray:
    """The place of the route that each passes the posts like; -1 where it is none."""
    found = scene.rays.signatures(
        anchors.positions, resolution=scene.resolution, origin=scene.origin
    )
    known = [route.signature for route in scene.routes]
    return np.array([known.index(one) if one in known else -1 for one in found])


def test_anchors_stay_on_their_own_route_where_it_has_something_safe() -> None:
    """Each gap is a route; without routes the finish changes more of them."""
    scene = scene_of()
    sampled = Refiner(scene, 1).refine(
        states_of(curves(scene, 8.0)), np.zeros(64, int), Spec(**UNFINISHED)
    )
    assert sampled.safe.mean() < 0.3
    route = np.maximum(places(scene, sampled), 0)
    assert len(np.unique(route)) > 1
    told, untold = refined(scene, steps=1, route=route), refined(scene, steps=1)
    assert told.safe.mean() > 0.9
    assert (places(scene, told) == route).mean() > 0.85
    assert (places(scene, told) == route).sum() > (places(scene, untold) == route).sum()


def test_a_route_that_has_lost_all_its_anchors_gets_one_back() -> None:
    """All anchors go one way; half of them are labelled with another route."""
    scene = scene_of()
    assert len(scene.routes) > 1
    own = scene.route_splines[np.zeros(64, int)]
    route = np.arange(64) % 2
    anchors = Refiner(scene, 5).refine(states_of(own), route, Spec())
    taken = places(scene, anchors)[anchors.safe]
    assert (taken == 0).sum() > 32
    assert 1 in taken


def test_one_anchor_of_a_scene_that_is_sound_never_touches_another() -> None:
    scene, route = scene_of(), np.zeros(64, int)
    states = states_of(curves(scene, 8.0))
    spec = Spec(project=True, barrier=True)
    together = Refiner(scene, 20).refine(states, route, spec)
    alone = Refiner(scene, 20).refine(states[5:6], route[5:6], spec)
    assert alone.safe.all()
    np.testing.assert_allclose(together.positions[5:6], alone.positions, atol=1e-3)
    np.testing.assert_allclose(together.duration[5:6], alone.duration, rtol=1e-3)


def test_where_nothing_can_be_safe_all_are_answered() -> None:
    """A robot that is too weak for its own start: no anchor is within the limits on any route."""
    scene = scene_of(x_curr=np.asarray([0.8, 3.2, 0.3, 0.0, 0.0, 9.0], np.float32))
    assert len(scene.routes) > 1
    route = np.arange(6) % len(scene.routes)
    refined = Refiner(scene, steps=6).refine(scene.route_states[route], route, Spec())
    assert not refined.safe.any()
    assert np.isfinite(refined.positions).all()
