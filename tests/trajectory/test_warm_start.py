"""Warm starts: a plan in place of the route that it follows, and of no other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.warm_start import resampled_states, warm_states

ROUTE = np.array([0, 1, 0, 1, 1])


@pytest.fixture
def scene() -> Scene:
    """A block half way, with a way round it on either side."""
    occupancy = np.zeros((1, 60, 60), np.float32)
    occupancy[0, 26:36, 26:34] = 1.0
    return Scene(
        cost_map=occupancy,
        resolution=0.1,
        origin=np.array([-3.0, -3.0]),
        robot_radius=0.2,
        x_curr=np.array([-2.0, 0.0, 0.5, 0.0, 0.0, 0.0]),
        x_goal=np.array([2.0, 0.0, 0.0, 0.0]),
        w_style=np.array([0.4, 0.3, 0.3]),
        motion=MotionLimits(v_max=2.0, a_max=3.0),
    )


def plan(side: float, duration: float, steps: int = 40) -> np.ndarray:
    """[T', 6] of p = (-2 + 4 s, 1.2 side sin^2 pi s), s = t / d, from start to goal."""
    s = np.linspace(0.0, 1.0, steps)
    bend = np.pi * np.sin(2 * np.pi * s)
    x = np.stack([-2 + 4 * s, 1.2 * side * np.sin(np.pi * s) ** 2], 1)
    v = np.stack([np.full(steps, 4.0), 1.2 * side * bend], 1) / duration
    a = np.stack([np.zeros(steps), 2.4 * side * np.pi**2 * np.cos(2 * np.pi * s)], 1) / duration**2
    return np.concatenate([x, v, a], 1)


def follows(scene: Scene, side: float) -> int:
    """The route on that side of the block."""
    middle = scene.route_states[:, 32, 1]
    assert len(middle) == 2
    return int((side * middle).argmax())


@pytest.mark.parametrize("columns", [2, 4, 6])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("duration", [4.0, 9.0])
def test_anchors_of_the_nearest_route_start_from_the_plan_in_own_time(
    scene: Scene, columns: int, side: float, duration: float
) -> None:
    given = plan(side, duration)[:, :columns]
    states = warm_states(scene, given, ROUTE, dt=duration / 39)
    assert (states.shape, states.dtype) == ((5, 64, 7), np.float32)
    on_plan = np.equal(ROUTE, follows(scene, side))
    np.testing.assert_array_equal(states[~on_plan], scene.route_states[ROUTE[~on_plan]])
    own_time = np.concatenate([plan(side, 1.0, 64), np.full((64, 1), np.log(duration))], 1)
    for order, tolerance in enumerate((1e-3, 2e-2, 1.0)):
        part = slice(2 * order, 2 * order + 2)
        expected = np.broadcast_to(own_time[:, part], (on_plan.sum(), 64, 2))
        np.testing.assert_allclose(states[on_plan][..., part], expected, atol=tolerance)
    np.testing.assert_allclose(states[on_plan][..., -1], np.log(duration), rtol=1e-6)


def test_without_dt_a_plan_lasts_as_long_as_its_route(scene: Scene) -> None:
    nearest = follows(scene, 1.0)
    states = warm_states(scene, plan(1.0, 5.0)[:, :2], ROUTE, dt=None)
    lasting = np.log(scene.route_splines.duration[nearest])
    np.testing.assert_allclose(states[nearest == ROUTE][..., -1], lasting, rtol=1e-6)


@pytest.mark.parametrize("dt", [None, 0.1])
def test_within_a_horizon_the_plans_way_is_gone_in_that(scene: Scene, dt: float | None) -> None:
    fixed = replace(scene, motion=replace(scene.motion, horizon_s=6.0))
    nearest = follows(fixed, 1.0)
    duration = 6.0 if dt is None else 3.9
    states = warm_states(fixed, plan(1.0, duration), ROUTE, dt=dt)
    np.testing.assert_allclose(states[..., -1], np.log(6.0), rtol=1e-6)
    warm = states[nearest == ROUTE][0]
    np.testing.assert_allclose(warm[:, :4], plan(1.0, 1.0, 64)[:, :4], atol=2e-2)


HORIZON_S = 7.0


def parabola(steps: int) -> np.ndarray:
    """States [2, steps, 6] of trajectories that splines represent exactly."""
    t = np.linspace(0.0, HORIZON_S, steps)
    one = np.ones_like(t)
    p, v, a = [0.5 * t**2 - t, 0.1 * t**2], [t - 1.0, 0.2 * t], [one, 0.2 * one]
    states = np.stack([*p, *v, *a], axis=1)
    return np.stack([states, -2 * states])


@pytest.mark.parametrize("columns", [2, 4, 6])
@pytest.mark.parametrize("steps", [4, 8, 31])
def test_missing_derivatives_and_steps_are_filled(steps: int, columns: int) -> None:
    given = parabola(steps)[..., :columns]
    got = resampled_states(given, dim=2, num_steps=8, horizon_s=HORIZON_S)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, parabola(8), atol=1e-5)


@pytest.mark.parametrize("steps", [2, 3, 4, 5, 12, 64])
@pytest.mark.parametrize("num_steps", [2, 7, 64])
def test_splines_are_those_of_scipy(steps: int, num_steps: int) -> None:
    given = np.random.default_rng(steps).normal(size=(3, steps, 2))
    spline = CubicSpline(np.linspace(0.0, HORIZON_S, steps), given, axis=1)
    times = np.linspace(0.0, HORIZON_S, num_steps)

    got = resampled_states(given, dim=2, num_steps=num_steps, horizon_s=HORIZON_S)
    expected = np.concatenate([spline(times, order) for order in range(3)], axis=-1)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6)
