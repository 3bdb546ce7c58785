"""The rollout of a car that tracks a trajectory: it brakes and steers with a delay.

The controller is the one of the PDM score, an LQR on a kinematic bicycle as nuPlan's simulation has
it (`anchorflow_trajectory.car.tracking`), in steps of a quarter of a second in place of a tenth.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

LOOKS_S = 1.0
"""Lookahead of the controller, which holds one command."""
SPEEDING = 10 / 11  # m/s² for each m/s that the speed differs from what is wanted then
PULL_LAG_S = 0.2
HEADING, LATERAL = 10.0, 1.0  # what errors cost; a steering rate costs 1
# What comes of its ten steps at 1 m/s: metres to the side, of a curvature and of one that grows
# from nought, and radians, of the latter.
SHIFT, SHIFT_OF_RATE, TURN_OF_RATE = 0.45, 0.12, 0.45
PASSED_ON = 0.6  # of a steering rate, by a lag of 0.05 s; fitted to what it drives
SHARPEST = 0.5  # 1/m
WHEELBASE = 0.5968  # in lengths (`anchorflow_driving.window.WHEELBASE`)
SLOWEST_TURN = 1.0  # m/s; below it a curvature is noise
_LEAST = 0.3  # m, of a way by which a turn is divided


class Start(NamedTuple):
    """[B] each: m/s, m/s² along the heading, 1/m to the left, m between the axles."""

    speed: Tensor
    acceleration: Tensor
    curvature: Tensor
    wheelbase: Tensor

    @classmethod
    def of(cls, motion: Tensor, *, wheelbase: float) -> Start:
        """Return the start of a car with velocity and acceleration [B, 4], forward and left."""
        speed, acceleration = motion[:, 0], motion[:, 2]
        axles = torch.full_like(speed, wheelbase)
        return cls(speed.clamp(min=0.0), acceleration, curvature_of(motion), axles)


class Driven(NamedTuple):
    """Poses [B, N, T, 3], and m/s at them, [B, N, T]."""

    poses: Tensor
    speed: Tensor


class _Wanted(NamedTuple):
    """The reference at every step, [B, N, 2T] each."""

    x: Tensor
    y: Tensor
    heading: Tensor
    speed: Tensor
    """m/s, a second later."""
    bend: Tensor
    """rad/m, in the second that follows."""
    shift: Tensor
    """Twice the metres aside in that second by the square of its way."""


class _Steering(NamedTuple):
    """[B, N, 2T] each: by how much a curvature falls in a step, 1/m, for each unit of an error."""

    aside: Tensor
    askew: Tensor
    bend: Tensor
    shift: Tensor


def driven(poses: Tensor, start: Start, *, dt: float) -> Driven:
    """Return the rollout of a car that tracks poses [B, N, T, 3].

    dt: s, from pose to pose
    """
    step = 0.5 * dt
    wanted = _wanted(poses, dt=dt)
    speed, pull, bend, wheelbase = (each[:, None].expand_as(poses[..., 0, 0]) for each in start)
    pace = _paces(speed, pull, wanted.speed, step=step)
    before, after = pace[..., :-1], pace[..., 1:]
    steering = _steering(before, wheelbase[..., None], step=step)
    own = _steered(wanted, steering, bend, ways=0.5 * step * (before + after))
    return Driven(own, pace[..., 2::2])


def _wanted(poses: Tensor, *, dt: float) -> _Wanted:
    count = 2 * poses.shape[-2]
    looks = min(max(round(LOOKS_S / (0.5 * dt)), 1), count)
    track = torch.cat([torch.zeros_like(poses[..., :1, :]), halved(poses)], -2)
    ways = track[..., ::2, :2].diff(dim=-2).square().sum(-1).clamp(min=1e-8).sqrt()
    speeds = ways / dt
    between = torch.cat([0.5 * (speeds[..., :-1] + speeds[..., 1:]), speeds[..., -1:]], -1)
    speed = torch.stack([speeds, between], -1).flatten(-2)
    arc = torch.nn.functional.pad((0.5 * ways).repeat_interleave(2, -1).cumsum(-1), (1, 0))
    way = (arc[..., looks:] - arc[..., :-looks]).clamp(min=_LEAST)
    dx, dy, turn = (track[..., looks:, :] - track[..., :-looks, :]).unbind(-1)
    x, y, heading = track[..., :-1, :].unbind(-1)
    now = heading[..., : dx.shape[-1]]
    shift = 2 * (dy * now.cos() - dx * now.sin()) / way.square()
    ahead = (_with_last(each, count) for each in (speed[..., looks - 1 :], turn / way, shift))
    return _Wanted(x, y, heading, *ahead)


def _with_last(values: Tensor, count: int) -> Tensor:
    """Repeat the last value until there are `count`: [..., count]."""
    more = count - values.shape[-1]
    return torch.cat([values, values[..., -1:].expand(*values.shape[:-1], more)], -1)


def _paces(speed: Tensor, pull: Tensor, wanted: Tensor, *, step: float) -> Tensor:
    """[B, N, 2T + 1] m/s, now and after every step, of a car that heads for speeds [B, N, 2T]."""
    share = step / (step + PULL_LAG_S)
    paces = [speed]
    for aim in (share * SPEEDING * wanted).unbind(-1):
        pull = (1 - share) * pull + (aim - share * SPEEDING * paces[-1])
        paces.append((paces[-1] + step * pull).clamp(min=0.0))
    return torch.stack(paces, -1)


def _steering(speed: Tensor, wheelbase: Tensor, *, step: float) -> _Steering:
    """Return the controller's gains at speeds [B, N, 2T]: it weighs the errors at its lookahead
    against the cost of a steering rate.
    """
    square = speed.square()
    turn, shift = TURN_OF_RATE * speed / wheelbase, SHIFT_OF_RATE * square / wheelbase
    cost = LATERAL * shift.square() + HEADING * turn.square() + 1
    passed = PASSED_ON * step / (wheelbase * cost)
    aside, askew = passed * LATERAL * shift, passed * HEADING * turn
    return _Steering(aside, aside * speed + askew, askew * speed, SHIFT * aside * square)


def _steered(wanted: _Wanted, steering: _Steering, bend: Tensor, *, ways: Tensor) -> Tensor:
    """Poses [B, N, T, 3] of a car that goes ways [B, N, 2T] m and bends so now."""
    # The steering at a step is linear in the car's pose and curvature there.
    by_x, by_y = steering.aside * wanted.heading.sin(), -steering.aside * wanted.heading.cos()
    aim = steering.askew * wanted.heading - by_x * wanted.x - by_y * wanted.y
    aim = aim + steering.bend * wanted.bend + steering.shift * wanted.shift
    kept = 1 - steering.bend - steering.shift
    halves, quarters = 0.5 * ways, 0.25 * ways
    x = y = heading = torch.zeros_like(bend)
    track = []
    for now in range(ways.shape[-1]):
        at = (..., now)
        later = aim[at] + by_x[at] * x + by_y[at] * y
        later = later - steering.askew[at] * heading + kept[at] * bend
        later = later.clamp(-SHARPEST, SHARPEST)
        both = bend + later
        middle = heading + quarters[at] * both
        x = x + ways[at] * middle.cos()
        y = y + ways[at] * middle.sin()
        heading, bend = heading + halves[at] * both, later
        if now % 2:
            track.append(torch.stack([x, y, heading], -1))
    return torch.stack(track, -2)


def curvature_of(motion: Tensor) -> Tensor:
    """[B] 1/m to the left, of a velocity and an acceleration [B, 4]."""
    return motion[:, 3] / motion[:, 0].clamp(min=SLOWEST_TURN).square()


def halved(poses: Tensor) -> Tensor:
    """Poses [..., 2T, 3] with one in the middle of every two, the first being that of now."""
    before = torch.cat([torch.zeros_like(poses[..., :1, :]), poses[..., :-1, :]], -2)
    return torch.stack([0.5 * (before + poses), poses], -2).flatten(-3, -2)
