"""Which of several trajectories a person would drive: the nearer to the record, the likelier."""

from __future__ import annotations

from torch import Tensor


def distances(trajectories: Tensor, future: Tensor) -> Tensor:
    """Mean distance [B, M] in m of trajectories [B or 1, M, T, 3] from futures [B, T, 3]."""
    return (trajectories[..., :2] - future[:, None, :, :2]).norm(dim=-1).mean(-1)


def likeness_loss(logits: Tensor, distance: Tensor, *, over: float) -> Tensor:
    """Cross-entropy [B] of logits [B, M] with soft labels, which fall by e over so many metres."""
    labels = (-distance / over).softmax(-1)
    return -(labels * logits.log_softmax(-1)).sum(-1)
