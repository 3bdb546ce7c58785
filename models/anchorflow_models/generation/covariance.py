"""The prior's covariance as a metric: which ways a trajectory may be moved."""

from __future__ import annotations

from torch import Tensor


def along_prior(gradient: Tensor, prior_basis: Tensor) -> Tensor:
    """Σ_0 g, the steepest change of a state that the prior's own smooth curves can make.

    gradient: g [B, N, T, S]; prior_basis: B_0 [B, R, T S], so that Σ_0 = B_0' B_0

    Whatever g is, the result belongs to a trajectory whose velocity and acceleration are its
    position's own, and it leaves both ends where they are.
    """
    noise = gradient.flatten(2) @ prior_basis.transpose(1, 2)
    return (noise @ prior_basis).reshape(gradient.shape)
