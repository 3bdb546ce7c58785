"""A car that hardly moves stands."""

from __future__ import annotations

from torch import Tensor

from anchorflow_client.contract.batch import STANDS


def standing_still(poses: Tensor) -> Tensor:
    """Poses [..., T, D] in the frame of a car, x and y first (m), as they are, and of trajectories
    that stay within STANDS all zeros: who goes no farther in some seconds is meant to stand.

    Networks answer a stop with some decimetres. Driven again and again every half a second, they
    become a creep, into whoever stands before the car.
    """
    moves = poses[..., :2].square().sum(-1).amax(-1) > STANDS**2
    return poses * moves[..., None, None].to(poses.dtype)
