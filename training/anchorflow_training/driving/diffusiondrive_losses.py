"""What DiffusionDriveV2's poses and choices are worth, by numbers to learn from."""

from __future__ import annotations

import torch
from torch import Tensor

from anchorflow_models.sub_scores import pdm_score

FAILED = -1.0  # the advantage of what collides or leaves the road
LEAST_SPREAD = 1e-4  # of the scores of one anchor's samples


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


def pose_distance(poses: Tensor, others: Tensor) -> Tensor:
    """Mean absolute differences [...] of poses [..., T, 3], headings the short way round."""
    apart = poses - others
    turn = torch.atan2(apart[..., 2].sin(), apart[..., 2].cos())
    return torch.cat([apart[..., :2], turn[..., None]], -1).abs().mean((-1, -2))
