"""The parts of V2X-VLM's loss."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

METRES = 10.0
"""That a place is told in."""


def regression(waypoints: Tensor, driven: Tensor) -> Tensor:
    """Smooth L1 of waypoints [B,T,2], m."""
    return F.smooth_l1_loss(waypoints, driven)


def alignment(image: Tensor, text: Tensor, *, kappa: float) -> Tensor:
    """InfoNCE in both directions between unit vectors [B,P], of which pairs share a row.

    -1/2B Σ_i [log softmax_j(z_i·h_j / κ)_i + log softmax_j(z_j·h_i / κ)_i]
    """
    likeness = image @ text.T / kappa
    pairs = torch.arange(len(likeness), device=likeness.device)
    return (F.cross_entropy(likeness, pairs) + F.cross_entropy(likeness.T, pairs)) / 2


def distribution_distillation(student: Tensor, teacher: Tensor, *, temperature: float) -> Tensor:
    """τ² KL(softmax(teacher/τ) ‖ softmax(student/τ)) over the 2T coordinates of [B,T,2], of
    temperature τ.

    As it was published. A softmax over coordinates gives nearly all the weight to the waypoints
    that lie farthest ahead, and moving all of them alike changes nothing.
    """
    wanted = F.log_softmax(teacher.flatten(1) / temperature, -1)
    got = F.log_softmax(student.flatten(1) / temperature, -1)
    divergence = F.kl_div(got, wanted, reduction="batchmean", log_target=True)
    return temperature**2 * divergence


def regression_distillation(student: Tensor, teacher: Tensor) -> Tensor:
    """Smooth L1 from the teacher's waypoints [B,T,2], m."""
    return F.smooth_l1_loss(student, teacher)


def next_token(logits: Tensor, wanted: Tensor, mask: Tensor) -> Tensor:
    """Cross-entropy of logits [B,L,V] where the mask [B,L] is true."""
    return F.cross_entropy(logits[mask], wanted[mask])


def location(near: Tensor, place: Tensor, nearest: Tensor) -> Tensor:
    """Of the nearest other [B,3]: whether it is there, and x, y in m, where it is.

    near: logits [B]; place: [B,2], tens of metres
    """
    there = nearest[:, 0]
    apart = (place - nearest[:, 1:] / METRES).abs().mean(-1)
    return F.binary_cross_entropy_with_logits(near, there) + (there * apart).mean()
