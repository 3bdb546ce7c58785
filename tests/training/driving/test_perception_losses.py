"""What perception learns of others that move."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from anchorflow_models.transfuser import Moving
from anchorflow_training.driving.losses import THERE, motion_loss

REACH = 8.0
BOXES = torch.tensor([[[4.5, 2.5, 0.0, 3.0, 1.0], [-4.5, -2.5, math.pi / 2, 3.0, 1.0]]])
VELOCITY = torch.tensor([[[6.0, 1.0], [0.0, 0.0]]])


def loss(there: Tensor, velocity: Tensor, *, count: int = 2) -> float:
    moving = Moving(there, velocity)
    told = motion_loss(moving, BOXES, VELOCITY, torch.tensor([count]), cell=1.0, ahead=REACH)
    return float(told)


def truth() -> tuple[Tensor, Tensor]:
    """Cells of 1 m, row 0 farthest ahead, column 0 farthest left."""
    there, velocity = torch.full((1, 16, 16), -30.0), torch.zeros(1, 2, 16, 16)
    there[0, 2:5, 5] = 30.0  # x from 3 to 6, y from 2 to 3
    velocity[0, :, 2:5, 5] = VELOCITY[0, 0, :, None]
    there[0, 12, 9:12] = 30.0  # it stands across: y from -1 to -4
    return there, velocity


def test_the_truth_costs_nothing() -> None:
    assert loss(*truth()) < 1e-9


def test_who_moves_weighs_four_times_who_stands() -> None:
    there, velocity = truth()
    faster, rolling = velocity.clone(), velocity.clone()
    faster[0, 0, 2:5, 5] += 2.0  # smooth L1: 1.85
    rolling[0, 0, 12, 9:12] += 2.0
    assert math.isclose(loss(there, faster), 1.85 * 12 / 15, rel_tol=1e-5)
    assert math.isclose(loss(there, rolling), 1.85 * 3 / 15, rel_tol=1e-5)


def test_who_is_not_counted_is_not_there() -> None:
    there, velocity = truth()
    assert math.isclose(loss(there, velocity, count=1), THERE * 3 * 30 / 256, rel_tol=1e-5)


def test_where_nobody_is_no_velocity_is_learnt() -> None:
    there, velocity = truth()
    velocity[0, :, 8, 8] = 50.0
    assert loss(there, velocity) < 1e-9


def test_cells_may_begin_farther_ahead() -> None:
    there, velocity = truth()
    far = BOXES + torch.tensor([20.0, 0.0, 0.0, 0.0, 0.0])
    moving, count = Moving(there, velocity), torch.tensor([2])
    told = motion_loss(moving, far, VELOCITY, count, cell=1.0, ahead=REACH + 20.0)
    assert told < 1e-9
    narrow = Moving(there[..., 4:12], velocity[..., 4:12])  # 4 m to either side
    assert motion_loss(narrow, far, VELOCITY, count, cell=1.0, ahead=REACH + 20.0) < 1e-9
