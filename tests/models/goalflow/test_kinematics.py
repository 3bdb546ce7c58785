"""Ways of cars: closed forms of straight lines and arcs, and arcs that meet their goals."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from anchorflow_models.goalflow.kinematics import GRIP, SHARPEST, arc_to, roll_out, sharpest_at

T, DT = 8, 0.5
TIMES = DT * torch.arange(1, T + 1)


def constant(value: float) -> Tensor:
    return torch.full((T,), value)


def test_a_straight_line_at_constant_acceleration() -> None:
    poses = roll_out(torch.tensor(5.0), constant(1.0), constant(0.0), dt=DT)

    torch.testing.assert_close(poses[:, 0], 5 * TIMES + 0.5 * TIMES**2)
    assert not poses[:, 1:].any()


def test_an_arc_at_constant_speed() -> None:
    poses = roll_out(torch.tensor(6.0), constant(0.0), constant(0.1), dt=DT)

    angle = 0.6 * TIMES
    torch.testing.assert_close(poses[:, 2], angle)
    torch.testing.assert_close(poses[:, 0], 10 * angle.sin(), atol=0.03, rtol=0)
    torch.testing.assert_close(poses[:, 1], 10 * (1 - angle.cos()), atol=0.03, rtol=0)


def test_who_brakes_stands_and_does_not_turn_back() -> None:
    poses = roll_out(torch.tensor(4.0), constant(-4.0), constant(0.0), dt=DT)

    assert poses[-1, 0].item() == pytest.approx(2.0, abs=0.05)
    assert (poses.diff(dim=0)[:, 0] >= 0).all()


@pytest.mark.parametrize("goal", [(30.0, 0.0), (25.0, 8.0), (20.0, -12.0), (10.0, 3.0), (3.0, 0.1)])
def test_an_arc_meets_its_goal(goal: tuple[float, float]) -> None:
    speed = torch.tensor(6.0)
    acceleration, curvature = arc_to(torch.tensor(goal), speed, duration=T * DT)
    poses = roll_out(speed, acceleration.expand(T), curvature.expand(T), dt=DT)

    assert math.dist(poses[-1, :2].tolist(), goal) < 0.25


def test_a_goal_behind_or_here_is_a_halt_not_a_nan() -> None:
    goals = torch.tensor([[0.0, 0.0], [-5.0, 0.0], [0.0, 5.0]], requires_grad=True)
    acceleration, curvature = arc_to(goals, torch.tensor([0.0, 8.0, 2.0]), duration=T * DT)
    (acceleration.sum() + curvature.sum()).backward()

    assert torch.isfinite(torch.stack([acceleration, curvature])).all()
    assert goals.grad is not None
    assert torch.isfinite(goals.grad).all()


def test_a_fast_car_bends_no_more_than_its_tyres_hold() -> None:
    speed = torch.tensor([0.0, 5.0, 20.0, 50.0])
    steady, slowing = (
        sharpest_at(speed, torch.full((4, T), pull), dt=DT).unbind(-1) for pull in (0.0, -2.0)
    )

    torch.testing.assert_close(
        steady[-1], torch.tensor([SHARPEST, SHARPEST, GRIP / 20**2, GRIP / 50**2])
    )
    torch.testing.assert_close(slowing[0], steady[0])
    torch.testing.assert_close(slowing[-1][2:], GRIP / torch.tensor([13.0, 43.0]).square())
