"""Losses of sub-scores that are foretold of many trajectories, and of their order."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

SHARPNESS = 0.05  # of scores, in which one trajectory is told from another


def sub_score_loss(logits: Tensor, truth: Tensor) -> Tensor:
    """Binary cross-entropy of sub-scores [B, M, 5] in the order of SUB_SCORES, or [B, M, 6] with
    DDC, each by what it counts: EP, TTC and C by NC x DAC, as the PDM score multiplies.

    Of what collides the score is 0 however far it came. Heads that learnt that too would count
    every risk twice, once by NC and again by EP and TTC, and prefer whatever creeps. Learnt so,
    NC DAC (5 EP + 5 TTC + 2 C) / 12 of what they foretell is the score to be expected.
    """
    losses = F.binary_cross_entropy_with_logits(logits, truth, reduction="none")
    counts = torch.ones_like(truth)
    counts[..., 2:5] = truth[..., :1] * truth[..., 1:2]
    return ((losses * counts).sum((0, 1)) / counts.sum((0, 1)).clamp(min=1.0)).mean()


def wrong_order(scores: Tensor, worth: Tensor) -> Tensor:
    """Logistic loss of all pairs of scores [B, M], each by how far apart they are worth [B, M]."""
    above = (worth[:, :, None] - worth[:, None]).clamp(min=0.0)
    apart = (scores[:, :, None] - scores[:, None]) / SHARPNESS
    return (above * F.softplus(-apart)).sum() / above.sum().clamp(min=1.0)
