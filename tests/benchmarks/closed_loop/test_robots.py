"""The robots against motions in closed form, within their limits, sample by sample."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from anchorflow_benchmarks.closed_loop.path_following import motions_along
from anchorflow_benchmarks.closed_loop.robots import ROBOTS, DoubleIntegrator, Robot, Unicycle

BOTH = [Unicycle(), DoubleIntegrator()]


def drive(robot: Robot, state: torch.Tensor, control: list[float], steps: int, dt: float):
    for _ in range(steps):
        state = robot.step(state, torch.tensor(control), dt)
    return state


def test_a_unicycle_at_constant_speed_and_yaw_rate_drives_a_circle() -> None:
    speed, yaw_rate = 1.0, 0.5
    ends = []
    for steps in (10, 20):
        state = torch.tensor([0.0, 0.0, 0.0, speed, yaw_rate], dtype=torch.float64)
        for _ in range(steps):
            state = Unicycle().step(state, torch.zeros(2, dtype=torch.float64), 2.0 / steps)
        ends.append(state[:2].numpy())
    radius, angle = speed / yaw_rate, yaw_rate * 2.0
    exact = radius * np.array([math.sin(angle), 1.0 - math.cos(angle)])

    errors = [np.linalg.norm(end - exact) for end in ends]
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)  # the midpoint's second order


def test_a_double_integrator_falls() -> None:
    end = drive(DoubleIntegrator(), torch.tensor([1.0, 2.0, 0.5, 0.0]), [0.0, 1.0], 1000, 0.001)
    np.testing.assert_allclose(end.numpy(), [1.5, 2.5, 0.5, 1.0], atol=2e-3)


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=30))
@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_no_control_breaks_the_limits(name: str, controls: list[tuple[float, float]]) -> None:
    robot = ROBOTS[name]()
    state = robot.start(np.zeros(3))
    for control in controls:
        after = robot.step(state, torch.tensor(control, dtype=torch.float32), 0.1)
        assert float(robot.speed(after).abs()) <= robot.v_max + 1e-5
        change = robot.x_curr(after)[2:4] - robot.x_curr(state)[2:4]
        if isinstance(robot, DoubleIntegrator):
            assert np.linalg.norm(change) <= robot.a_max * 0.1 + 1e-5
        else:
            assert abs(float(after[3] - state[3])) <= robot.a_max * 0.1 + 1e-5
        state = after


@pytest.mark.parametrize("robot", BOTH)
def test_braking_ends_at_rest_and_stays_there(robot: Robot) -> None:
    state = robot.start(np.zeros(3))
    state = drive(robot, state, [2.0, 1.0], 6, 0.1)
    for _ in range(12):
        state = robot.step(state, robot.braking(state, 0.1), 0.1)
    assert float(robot.speed(state).abs()) < 1e-6
    rest = robot.pose(state)
    np.testing.assert_array_equal(
        robot.pose(robot.step(state, robot.braking(state, 0.1), 0.1)), rest
    )


def test_a_unicycle_tells_its_velocity_and_its_bend_in_the_map_frame() -> None:
    state, aside = torch.tensor([1.0, 2.0, math.pi / 3, 1.5, 0.7]), 1.5 * 0.7
    expected = [1.0, 2.0, 0.75, 1.5 * math.sin(math.pi / 3)]
    expected += [-aside * math.sin(math.pi / 3), 0.5 * aside]
    np.testing.assert_allclose(Unicycle().x_curr(state), expected, atol=1e-6)
    # v w = 5 m/s^2 to the right is more than anchors may be asked to begin with.
    state = torch.tensor([0.0, 0.0, 0.0, 2.0, -2.5])
    np.testing.assert_allclose(Unicycle().x_curr(state), [0, 0, 2, 0, 0, -3], atol=1e-6)


@pytest.mark.parametrize("robot", BOTH)
def test_a_long_step_ends_where_many_short_ones_do(robot: Robot) -> None:
    start, control = robot.start(np.array([0.0, 0.0, 0.4])), torch.tensor([1.5, 1.0])
    several = start
    for _ in range(5):
        several = robot.step(several, control, 0.02)
    torch.testing.assert_close(robot.step(start, control, 0.1), several, atol=2e-4, rtol=0.0)


@pytest.mark.parametrize("robot", BOTH)
def test_one_sample_never_touches_another(robot: Robot) -> None:
    generator = torch.Generator().manual_seed(0)
    states = torch.randn(5, robot.state_size, generator=generator)
    controls = torch.randn(5, 2, generator=generator)
    together = robot.step(states, controls, 0.1)
    for one, state, control in zip(together, states, controls, strict=True):
        torch.testing.assert_close(robot.step(state, control, 0.1), one)


@pytest.mark.parametrize("robot", BOTH)
def test_a_path_is_followed_to_its_end(robot: Robot) -> None:
    bend = torch.linspace(0.0, math.pi / 2, 64)
    paths = torch.stack([2.0 * torch.sin(bend), 2.0 - 2.0 * torch.cos(bend)], 1)[None]
    _, states = motions_along(robot, paths, robot.start(np.zeros(3)), steps=60, dt=0.1, speed=1.0)

    places = states[0, :, :2]
    off = ((places[:, None] - paths[0]) ** 2).sum(-1).min(1).values.sqrt()
    assert float(off.max()) < 0.1
    assert float((places[-1] - paths[0, -1]).norm()) < 0.15
    assert float(robot.speed(states).max()) <= 1.0 + 1e-5


def test_a_unicycle_turns_on_the_spot_to_a_path_behind_it() -> None:
    line = torch.stack([-torch.linspace(0.0, 2.0, 64), torch.zeros(64)], 1)[None]
    start = Unicycle().start(np.zeros(3))
    _, states = motions_along(Unicycle(), line, start, steps=60, dt=0.1, speed=1.0)

    assert float(states[0, :, 1].abs().max()) < 0.25
    assert float(states[0, -1, 0]) < -1.5


@pytest.mark.parametrize("robot", BOTH)
def test_the_states_are_those_that_the_controls_bring_about(robot: Robot) -> None:
    paths = torch.randn(3, 64, 2, generator=torch.Generator().manual_seed(1)).cumsum(1) * 0.05
    state = robot.start(np.array([0.1, 0.0, 0.3]))
    controls, states = motions_along(robot, paths, state, steps=20, dt=0.1, speed=1.5)
    current = state.expand(3, -1)
    for step in range(20):
        current = robot.step(current, controls[:, step], 0.1)
        torch.testing.assert_close(current, states[:, step])
