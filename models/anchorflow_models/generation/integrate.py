"""Integrators in torch: one loop for the shared methods, and an adaptive method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor
from torchdiffeq import odeint

from anchorflow_models.generation.checks import check
from anchorflow_trajectory.ode.methods import Method
from anchorflow_trajectory.ode.schedule import Schedule, stage_times

RESOLVED = 10  # units of the dtype's rounding below which no tolerance can be met


class Stage(NamedTuple):
    """An evaluation of the field.

    time_index: counts the times of `stage_times(method, schedule)`, so that what depends on the
        time alone is worked out once for all of them
    stride: of the step that it belongs to
    """

    time_index: int
    stride: float


def integrate(
    vector_field: Callable[[Tensor, Stage], Tensor],
    x_0: Tensor,
    *,
    schedule: Schedule,
    method: Method,
) -> Tensor:
    """x at the schedule's end by an explicit method; dx/dt = vector_field(x, stage)."""
    x = x_0
    before: list[Tensor] = []  # of earlier steps, for a method that looks back
    stages = stage_times(method, schedule).index
    for step, ((start, end), indices) in enumerate(zip(pairwise(schedule), stages, strict=True)):
        h = end - start
        slopes: list[Tensor] = []
        for row, index in zip(method.a_lower, indices, strict=True):
            slopes.append(vector_field(_advanced(x, slopes, row, h), Stage(index, h)))
        before = [*slopes, *before][: method.slopes]
        x = _advanced(x, before, method.weights(schedule, step), h)
    return x


def integrate_adaptive(
    vector_field: Callable[[Tensor, Tensor], Tensor],
    x_0: Tensor,
    *,
    start: float,
    rtol: float,
    atol: float,
) -> Tensor:
    """x at t = 1 by Dormand and Prince's method of orders 5 and 4 (torchdiffeq's dopri5).

    dx/dt = vector_field(t, x), t [] in [start, 1]; x: [B, N, ...]

    Steps are those that the hardest of the samples needs, so that each of them meets the
    tolerance; a sample among others may differ from the same one alone by as much.

    Raises:
        ValueError: the tolerance is finer than x_0's dtype resolves.
    """
    least = RESOLVED * torch.finfo(x_0.dtype).eps
    check("rtol", rtol >= least, f"at least {least:.2g} for {x_0.dtype}", rtol)
    times = torch.tensor([start, 1.0], dtype=x_0.dtype, device=x_0.device)
    options = {"norm": _largest_norm}
    path = odeint(vector_field, x_0, times, rtol=rtol, atol=atol, method="dopri5", options=options)
    assert isinstance(path, Tensor)
    return path[-1]


def _advanced(x: Tensor, slopes: Sequence[Tensor], weights: Sequence[float], h: float) -> Tensor:
    """x + h Σ weights_i slopes_i."""
    for weight, slope in zip(weights, slopes, strict=True):
        if weight:
            x = x + (h * weight) * slope
    return x


def _largest_norm(x: Tensor) -> Tensor:
    """The largest root mean square of a sample of [B, N, ...]."""
    return x.flatten(2).square().mean(-1).max().sqrt()
