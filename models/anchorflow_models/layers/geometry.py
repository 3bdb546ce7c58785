"""Geometry that autocast does not round, and trajectories that stand still."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import torch
from torch import Tensor

from anchorflow_client.contract.batch import MIN_MOVE

P = ParamSpec("P")
R = TypeVar("R")


def in_float32(geometry: Callable[P, R]) -> Callable[P, R]:
    """The same function of float32 tensors, whose products no autocast rounds.

    A bfloat16 number has 8 bits: 3 cm at 8 m, and of a trajectory's second differences nothing is
    left. Outside of autocast nothing changes, nor does an exported graph.
    """

    @wraps(geometry)
    def exact(*args: P.args, **kwargs: P.kwargs) -> R:
        device = next(each.device.type for each in args if isinstance(each, Tensor))
        available = torch.amp.is_autocast_available(device)  # on the meta device it is not
        if not (available and torch.is_autocast_enabled(device)):
            return geometry(*args, **kwargs)
        with torch.autocast(device, enabled=False):
            return geometry(*args, **kwargs)

    return exact


def standing_still(poses: Tensor) -> Tensor:
    """Poses [..., T, D] in the frame of a car, x and y first (m), as they are, and of trajectories
    that stay within MIN_MOVE all zeros: who goes no farther in some seconds is meant to stand.

    Networks answer a stop with some decimetres. Executed again every half a second, they make the
    car creep into what is ahead.
    """
    moves = poses[..., :2].square().sum(-1).amax(-1) > MIN_MOVE**2
    return poses * moves[..., None, None].to(poses.dtype)
