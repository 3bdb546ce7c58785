"""Losses of what a Transfuser backbone is asked besides a plan."""

from __future__ import annotations

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor
from torch.nn import functional as F

HEADING = 2  # of x, y, heading, length, width


def focal_loss(
    logits: Tensor, classes: Tensor, *, alpha: float = 0.5, gamma: float = 2.0
) -> Tensor:
    """-α (1 - p)^γ log p of the true class, its mean (Lin et al., 2017).

    logits: [B, classes, H, W]; classes: integers [B, H, W]
    """
    log_p = logits.log_softmax(1).gather(1, classes.long()[:, None])[:, 0]
    return -(alpha * (1 - log_p.exp()).pow(gamma) * log_p).mean()


def occupancy_loss(logits: Tensor, occupied: Tensor) -> Tensor:
    """Binary cross-entropy, its mean; logits: [B, T, H, H]; occupied: 0 or 1 likewise."""
    return F.binary_cross_entropy_with_logits(logits, occupied.to(logits.dtype))


def agent_loss(states: Tensor, logits: Tensor, boxes: Tensor, count: Tensor) -> Tensor:
    """Binary cross-entropy of who is there, L1 of where; each box is matched to one query.

    states: [B, Q, 5] x, y, heading, length, width; logits: [B, Q]
    boxes: [B, Q, 5], the first count [B] of which are there
    """
    there = torch.zeros_like(logits)
    taken, wanted = [], []
    for b, number in enumerate(count.tolist()):
        query, box = match(states[b], logits[b], boxes[b, :number])
        there[b, query] = 1.0
        taken.append(states[b, query])
        wanted.append(boxes[b, box])
    told = F.binary_cross_entropy_with_logits(logits, there)
    apart = _apart(torch.cat(taken), torch.cat(wanted)).mean(-1)
    return told + apart.sum() / max(len(apart), 1)


@torch.no_grad()
def match(states: Tensor, logits: Tensor, boxes: Tensor) -> tuple[Tensor, Tensor]:
    """Which query tells of which box, at the least cost in all (the Hungarian method).

    states: [Q, 5]; logits: [Q]; boxes: [M, 5]; returns indices [min(Q, M)] of both
    """
    cost = _apart(states[:, None], boxes[None]).mean(-1) + F.softplus(-logits)[:, None]
    query, box = linear_sum_assignment(cost.float().cpu().numpy())
    device = states.device
    return torch.as_tensor(query, device=device), torch.as_tensor(box, device=device)


def _apart(states: Tensor, boxes: Tensor) -> Tensor:
    """Absolute differences, headings the short way round."""
    apart = states - boxes
    turn = apart[..., HEADING]
    turn = torch.atan2(turn.sin(), turn.cos())
    return torch.cat([apart[..., :HEADING], turn[..., None], apart[..., HEADING + 1 :]], -1).abs()
