"""Poses of a car's rear axle by its controls, acceleration and curvature."""

from __future__ import annotations

import torch
from torch import Tensor

SUBSTEPS = 4
"""Integration steps between two poses."""
BRAKING, PULLING = 6.0, 2.3
"""m/s², of the acceleration that is drawn."""
SHARPEST = 0.2
"""1/m, of the curvature."""
GRIP = 8.0
"""m/s² to the side, of what is drawn at any speed."""
_LEAST = 1e-3


def roll_out(speed: Tensor, acceleration: Tensor, curvature: Tensor, *, dt: float) -> Tensor:
    """Poses [..., T, 3] (x, y, heading) of a car that starts at the origin along x.

    speed: [...] m/s now; it does not fall below 0
    acceleration, curvature: [..., T] m/s², 1/m, each constant until its pose
    """
    step = dt / SUBSTEPS
    fine = acceleration.repeat_interleave(SUBSTEPS, -1)
    # What braking would take below 0 is not paid back by who drives off again.
    owed = speed[..., None] + step * fine.cumsum(-1)
    so_far = torch.ones(2 * owed.shape[-1:], dtype=torch.bool, device=owed.device).tril()
    after = owed - torch.where(so_far, owed[..., None, :], 0.0).amin(-1).clamp(max=0.0)
    before = torch.cat([speed[..., None], after[..., :-1]], -1)
    way = step * 0.5 * (before + after)
    turn = way * curvature.repeat_interleave(SUBSTEPS, -1)
    heading = turn.cumsum(-1)
    course = heading - 0.5 * turn
    x, y = ((way * part).cumsum(-1) for part in (course.cos(), course.sin()))
    poses = torch.stack([x, y, heading], -1)
    return poses[..., SUBSTEPS - 1 :: SUBSTEPS, :]


def sharpest_at(speed: Tensor, acceleration: Tensor, *, dt: float) -> Tensor:
    """Curvature [..., T] in 1/m that tyres let a car of speeds [...] drive, by [..., T] m/s²."""
    after = speed[..., None] + dt * acceleration.cumsum(-1)
    fastest = torch.maximum(after, after - dt * acceleration).clamp(min=(GRIP / SHARPEST) ** 0.5)
    return GRIP / fastest.square()


def within(curvature: Tensor, sharpest: Tensor) -> Tensor:
    """Curvatures that bend to either side by no more than the sharpest, 1/m, by broadcasting."""
    return torch.minimum(torch.maximum(curvature, -sharpest), sharpest)


def arc_to(goal: Tensor, speed: Tensor, *, duration: float) -> tuple[Tensor, Tensor]:
    """Return constant acceleration and curvature [...] of the arc that ends at goals [..., 2].

    speed: [...] m/s now; a car that cannot reach the goal at a speed above 0 halts there
    """
    x, y = goal[..., 0], goal[..., 1]
    square = (x.square() + y.square()).clamp(min=_LEAST)
    curvature = (2 * y / square).clamp(-SHARPEST, SHARPEST)
    chord = square.sqrt()
    # Half the arc's angle; a chord is as long as the arc times sinc of it.
    half = (0.5 * curvature * chord).clamp(-0.999, 0.999).asin()
    bent = half.abs() > _LEAST
    way = chord * torch.where(bent, half / half.sin().where(bent, 1.0), 1.0)
    meeting = 2 * (way - speed * duration) / duration**2
    halting = -speed.square() / (2 * way.clamp(min=_LEAST))
    acceleration = torch.where(way < 0.5 * speed * duration, halting, meeting)
    return acceleration.clamp(-BRAKING, PULLING), curvature
