"""Turn anchors into motions: the robot's model follows all paths at once."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from anchorflow_benchmarks.closed_loop.robots import BRAKING_SHARE, Robot
from anchorflow_client import resample
from anchorflow_client.planner import Plan

AHEAD_M, AHEAD_S = 0.25, 0.25  # distance of the carrot at rest, and per speed
WINDOW = 4  # samples of the path that a step may advance


def timed_paths(plan: Plan, *, period_s: float) -> tuple[Tensor, Tensor]:
    """Resample a usable plan's anchors from now on at a controller's period.

    Returns [M, S, 2] m and speeds [M, S] m/s with S for the longest anchor; shorter ones stay at
    their ends.
    """
    batch, states = plan.batch, plan.states()
    assert batch is not None  # the plan is usable
    dts = batch.durations / (states.shape[1] - 1)
    timed = [
        resample(*np.split(anchor, 3, axis=-1), dt=float(dt), period_s=period_s)
        for anchor, dt in zip(states, dts, strict=True)
    ]
    longest = max(len(anchor.times) for anchor in timed)
    paths, speeds = np.zeros((len(timed), longest, 2)), np.zeros((len(timed), longest))
    for n, anchor in enumerate(timed):
        count = len(anchor.times)
        paths[n, :count] = anchor.positions[:, :2]
        paths[n, count:] = anchor.positions[-1, :2]
        speeds[n, :count] = np.linalg.norm(anchor.velocities[:, :2], axis=1)
        speeds[n, count:] = speeds[n, count - 1]
    return torch.from_numpy(paths).float(), torch.from_numpy(speeds).float()


def motions_along(
    robot: Robot,
    paths: Tensor,
    state: Tensor,
    *,
    steps: int,
    dt: float,
    speed: float,
    paces: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Return the controls [M, steps, U] and states [M, steps, X] of a robot along paths [M, S, 2].

    From state [X] it chases a carrot on each path, as fast as bends allow, and brakes before the
    path's end. `paces` [M, S] m/s are the anchors' own speeds; without them it drives at `speed`
    m/s.
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
        # The carrot's speed counts at rest, that of the robot's place near the end.
        own = None if paces is None else torch.maximum(paces[rows, reached], paces[rows, carrot])
        wanted = torch.full_like(left, speed) if own is None else own.clamp(max=robot.v_max)
        pace = torch.minimum((braking * left).sqrt(), wanted)
        control = robot.steer(states, paths[rows, carrot], pace, dt)
        states = robot.step(states, control, dt)
        controls.append(control)
        motions.append(states)
    return torch.stack(controls, 1), torch.stack(motions, 1)


def _nearest(paths: Tensor, places: Tensor, reached: Tensor, window: int) -> Tensor:
    """Return the sample [M] of each path nearest to [M, 2], at most `window` further on."""
    index = torch.arange(paths.shape[1])
    square = ((paths - places[:, None]) ** 2).sum(-1)
    out = (index < reached[:, None]) | (index > reached[:, None] + window)
    return square.masked_fill(out, torch.inf).argmin(1)
