"""Which of several trajectories a person would drive: the nearer to the record, the likelier."""

from __future__ import annotations

from torch import Tensor


def distances(trajectories: Tensor, future: Tensor) -> Tensor:
    """Mean distance [B, M] in m of trajectories [B or 1, M, T, 3] from futures [B, T, 3]."""
    return (trajectories[..., :2] - future[:, None, :, :2]).norm(dim=-1).mean(-1)


def shares(counted: Tensor) -> Tensor:
    """Weights [B] of windows in a mean: alike where one is counted, 1, and not 0; they sum to 1,
    or are all 0.
    """
    return counted / counted.sum().clamp(min=1.0)


def by_shares(share: Tensor, losses: Tensor) -> Tensor:
    """The mean of losses [B] by shares [B]; no product, which autocast would round."""
    return (share * losses).sum()


def likeness_loss(logits: Tensor, distance: Tensor, *, over: float) -> Tensor:
    """Cross-entropy [B] of logits [B, M] with soft labels, which fall by e over so many metres."""
    labels = (-distance / over).softmax(-1)
    return -(labels * logits.log_softmax(-1)).sum(-1)
