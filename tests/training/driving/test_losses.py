"""Losses that the planners on driving logs share."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from anchorflow_models.transfuser import Moving
from anchorflow_training.driving.losses import (
    FAILED,
    THERE,
    advantages,
    motion_loss,
    pose_distance,
    sub_score_loss,
    wrong_order,
)


def test_pairs_in_the_wrong_order_by_hand() -> None:
    scores, worth = torch.tensor([[0.5, 0.6, 0.55]]), torch.tensor([[0.9, 0.1, 0.9]])
    # Two pairs count, 0.8 each: 0.1 and 0.05 in the wrong order are 2 and 1 sharpnesses.
    expected = (np.log1p(np.exp(2)) + np.log1p(np.exp(1))) / 2
    assert wrong_order(scores, worth).item() == pytest.approx(expected, rel=1e-4)
    assert wrong_order(scores, torch.ones(1, 3)).item() == 0.0


def test_what_collides_tells_nothing_of_progress() -> None:
    """Two of three collide: the best forecast of EP is that of the third, of NC a third."""
    truth = torch.tensor([[[0, 1, 0, 0, 1], [0, 1, 0, 0, 1], [1, 1, 0.8, 1, 1]]])
    foretold = torch.full((1, 1, 5), 0.5).logit().requires_grad_()
    (slope,) = torch.autograd.grad(sub_score_loss(foretold.expand(1, 3, 5), truth), foretold)
    nc, dac, ep, ttc, comfort = (5 * slope[0, 0]).tolist()
    assert nc == pytest.approx(0.5 - 1 / 3)
    assert dac == pytest.approx(0.5 - 1)
    assert ep == pytest.approx(0.5 - 0.8)
    assert ttc == pytest.approx(0.5 - 1)
    assert comfort == pytest.approx(0.5 - 1)


def test_where_all_collide_progress_teaches_nothing() -> None:
    logits = torch.zeros(1, 2, 5, requires_grad=True)
    (slope,) = torch.autograd.grad(sub_score_loss(logits, torch.zeros(1, 2, 5)), logits)
    assert (slope[..., 2:] == 0).all()
    assert (slope[..., :2] > 0).all()


T = 8


def test_advantages_by_hand() -> None:
    # Two anchors, three samples each, groups one after another; they differ in EP.
    told = torch.ones(1, 6, 5)
    told[0, :, 2] = torch.tensor([0.2, 0.9, 0.4, 0.9, 0.6, 0.9])
    told[0, 3, 0] = 0.5
    score = [(5 * ep + 5 + 2) / 12 for ep in (0.2, 0.4, 0.6)]
    spread = float(np.std(score, ddof=1))
    found = advantages(told, 2)[0]
    # The first anchor's samples are 0, 2 and 4: only the last lies above their mean. The second's
    # are 1, 3 and 5, of which one collided.
    assert found[[0, 2]].tolist() == [0.0, 0.0]
    assert found[4].item() == pytest.approx((score[2] - score[1]) / spread, rel=1e-4)
    assert found[3].item() == FAILED
    assert (found[[1, 5]] > 0).all()


def test_headings_are_apart_the_short_way_round() -> None:
    poses, others = torch.zeros(2, T, 3), torch.zeros(2, T, 3)
    poses[0, :, 2], others[0, :, 2] = 3.1, -3.1
    others[1, :, 0] = 3.0
    expected = torch.tensor([(2 * np.pi - 6.2) / 3, 1.0])
    torch.testing.assert_close(pose_distance(poses, others), expected, atol=1e-5, rtol=0)


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
