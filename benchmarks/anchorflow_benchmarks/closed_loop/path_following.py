"""Anchors as motions: the robot's own model drives along every path at once."""

from __future__ import annotations

import torch
from torch import Tensor

from anchorflow_benchmarks.closed_loop.robots import BRAKING_SHARE, Robot

AHEAD_M, AHEAD_S = 0.25, 0.25  # the carrot is that far ahead at rest, and that much more by speed
WINDOW = 4  # samples of the path by which a step may get further along it


def motions_along(
    robot: Robot, paths: Tensor, state: Tensor, *, steps: int, dt: float, speed: float
) -> tuple[Tensor, Tensor]:
    """Controls [M, steps, U] with which a robot at [X] follows paths [M, S, 2] in m, and states.

    The states [M, steps, X] are those after each control.

    It chases a point a little ahead on each path, at `speed` m/s where bends allow it, and slows
    down before the path's end. An anchor's time law is left aside: it lasts the whole horizon,
    however near its goal is.
    """
    count, samples, _ = paths.shape
    lengths = torch.zeros(count, samples)
    lengths[:, 1:] = torch.diff(paths, dim=1).norm(dim=-1).cumsum(1)
    braking = 2.0 * BRAKING_SHARE * float(robot.control_limit[0])
    states, rows = state.expand(count, -1), torch.arange(count)
    reached = torch.zeros(count, dtype=torch.long)
    controls, motions = [], []
    for step in range(steps):
        reached = _nearest(paths, states[:, :2], reached, samples if step == 0 else WINDOW)
        done = lengths[rows, reached]
        ahead = done + AHEAD_M + AHEAD_S * robot.speed(states).abs()
        carrot = (lengths < ahead[:, None]).sum(1).clamp(max=samples - 1)
        left = (lengths[:, -1] - done).clamp(min=0.0)
        pace = (braking * left).sqrt().clamp(max=speed)
        control = robot.steer(states, paths[rows, carrot], pace, dt)
        states = robot.step(states, control, dt)
        controls.append(control)
        motions.append(states)
    return torch.stack(controls, 1), torch.stack(motions, 1)


def _nearest(paths: Tensor, places: Tensor, reached: Tensor, window: int) -> Tensor:
    """[M], the sample of each path [M, S, 2] nearest to [M, 2], at most `window` further on."""
    index = torch.arange(paths.shape[1])
    square = ((paths - places[:, None]) ** 2).sum(-1)
    out = (index < reached[:, None]) | (index > reached[:, None] + window)
    return square.masked_fill(out, torch.inf).argmin(1)
