"""What a car drives that is told to follow a trajectory: it brakes and steers later.

The controller is the one of the PDM score, an LQR on a kinematic bicycle as nuPlan's simulation has
it (`anchorflow_driving.pdm.tracker`), in steps of a quarter of a second in place of a tenth.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

LOOKS_S = 1.0
"""That the controller looks ahead, holding one command."""
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
        """Of a car with the velocity and acceleration [B, 4], forward and to the left."""
        speed, acceleration = motion[:, 0], motion[:, 2]
        axles = torch.full_like(speed, wheelbase)
        return cls(speed.clamp(min=0.0), acceleration, curvature_of(motion), axles)


class Driven(NamedTuple):
    """Poses [B, N, T, 3], and m/s at them, [B, N, T]."""

    poses: Tensor
    speed: Tensor


def driven(poses: Tensor, start: Start, *, dt: float) -> Driven:
    """What is driven by who follows poses [B, N, T, 3].

    dt: s, from pose to pose
    """
    count, step = 2 * poses.shape[-2], 0.5 * dt
    looks = min(max(round(LOOKS_S / step), 1), count)
    wanted = torch.cat([torch.zeros_like(poses[..., :1, :]), halved(poses)], -2)
    x_to, y_to, heading_to = wanted.unbind(-1)
    cos_to, sin_to = heading_to.cos(), heading_to.sin()
    ways = wanted[..., ::2, :2].diff(dim=-2).square().sum(-1).clamp(min=1e-8).sqrt()
    speeds = ways / dt
    between = 0.5 * (speeds[..., :-1] + speeds[..., 1:])
    # At steps 1, 2, … of the quarters: halfway between two poses, at a pose, and so on.
    speed_to = torch.stack([speeds[..., :-1], between], -1).flatten(-2)
    speed_to = torch.cat([speed_to, speeds[..., -1:]], -1)
    # How it bends in the second that follows: radians a metre, and metres aside a square metre.
    arc = torch.nn.functional.pad((0.5 * ways).repeat_interleave(2, -1).cumsum(-1), (1, 0))
    way_then = (arc[..., looks:] - arc[..., :-looks]).clamp(min=_LEAST)
    dx, dy, turn_then = (wanted[..., looks:, :] - wanted[..., :-looks, :]).unbind(-1)
    shift_then = dy * cos_to[..., :-looks] - dx * sin_to[..., :-looks]
    bend_to, shift_to = turn_then / way_then, 2 * SHIFT * shift_then / way_then.square()
    speed, pull, bend, wheelbase = (each[:, None].expand_as(speeds[..., 0]) for each in start)
    x = y = heading = torch.zeros_like(speed)
    last = speed_to.shape[-1] - 1
    track = []
    for now in range(count):
        aside = (y - y_to[..., now]) * cos_to[..., now] - (x - x_to[..., now]) * sin_to[..., now]
        askew = heading - heading_to[..., now]
        then = min(now, bend_to.shape[-1] - 1)
        askew_then = askew + speed * (bend - bend_to[..., then])
        shifted = speed.square() * (SHIFT * bend - shift_to[..., then])
        aside_then = aside + speed * askew + shifted
        turn = TURN_OF_RATE * speed / wheelbase
        shift = SHIFT_OF_RATE * speed.square() / wheelbase
        cost = LATERAL * shift.square() + HEADING * turn.square() + 1
        rate = -(LATERAL * shift * aside_then + HEADING * turn * askew_then) / cost
        later = (bend + PASSED_ON * step * rate / wheelbase).clamp(-SHARPEST, SHARPEST)
        command = SPEEDING * (speed_to[..., min(now + looks - 1, last)] - speed)
        pull = pull + step / (step + PULL_LAG_S) * (command - pull)
        after = (speed + step * pull).clamp(min=0.0)
        way = step * 0.5 * (speed + after)
        turned = way * 0.5 * (bend + later)
        x = x + way * (heading + 0.5 * turned).cos()
        y = y + way * (heading + 0.5 * turned).sin()
        heading, speed, bend = heading + turned, after, later
        track.append(torch.stack([x, y, heading, speed], -1))
    own, fast = torch.stack(track[1::2], -2).split([3, 1], -1)
    return Driven(own, fast[..., 0])


def curvature_of(motion: Tensor) -> Tensor:
    """[B] 1/m to the left, of a velocity and an acceleration [B, 4]."""
    return motion[:, 3] / motion[:, 0].clamp(min=SLOWEST_TURN).square()


def halved(poses: Tensor) -> Tensor:
    """Poses [..., 2T, 3] with one in the middle of every two, the first being that of now."""
    before = torch.cat([torch.zeros_like(poses[..., :1, :]), poses[..., :-1, :]], -2)
    return torch.stack([0.5 * (before + poses), poses], -2).flatten(-3, -2)
