"""What DiffusionDriveV2's poses and choices are worth, by numbers to learn from."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from anchorflow_models.diffusiondrive.scorers import pdm_score

FAILED = -1.0  # the advantage of what collides or leaves the road
LEAST_SPREAD = 1e-4  # of the scores of one anchor's samples
SHARPNESS = 0.05  # of scores, in which one candidate is told from another


def advantages(sub_scores: Tensor, anchors: int) -> Tensor:
    """[B, A G] of sub-scores [B, A G, 5], groups of all anchors one after another.

    How far a sample's PDM score lies above the mean of its own anchor's, in their deviations; 0
    where it lies below, as another anchor's manner is no fault; FAILED where it collides or leaves
    the road (Zou et al., 2025: intra-anchor groups, truncated).
    """
    nc, dac = sub_scores[..., 0], sub_scores[..., 1]
    score = pdm_score(sub_scores).unflatten(1, (-1, anchors))
    above = score - score.mean(1, keepdim=True)
    relative = above / score.std(1, keepdim=True).clamp(min=LEAST_SPREAD)
    kept = relative.clamp(min=0.0).flatten(1)
    return torch.where((nc < 1) | (dac < 1), torch.full_like(kept, FAILED), kept)


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


def pose_distance(poses: Tensor, others: Tensor) -> Tensor:
    """Mean absolute differences [...] of poses [..., T, 3], headings the short way round."""
    apart = poses - others
    turn = torch.atan2(apart[..., 2].sin(), apart[..., 2].cos())
    return torch.cat([apart[..., :2], turn[..., None]], -1).abs().mean((-1, -2))
