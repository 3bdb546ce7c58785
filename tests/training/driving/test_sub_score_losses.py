"""Losses of foretold sub-scores and of their order, by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from anchorflow_training.driving.losses import sub_score_loss, wrong_order


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
