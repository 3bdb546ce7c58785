"""What was driven of several plans, one after the other."""

from __future__ import annotations

import numpy as np

from anchorflow_driving.pdm.comfort import comfort
from anchorflow_driving.pdm.tracker import STEPS, Motion
from anchorflow_driving.window import EgoState

QUANTITIES = ("poses", "speed", "acceleration", "yaw_rate")


def first_steps(motion: Motion, steps: int) -> Motion:
    """The motion's start and as many steps."""
    return _cut(motion, slice(0, steps + 1))


def state_after(motion: Motion, step: int) -> EgoState:
    """How the only plan's vehicle moves after a step."""
    speed = float(motion.speed[0, step])
    return EgoState(
        pose=motion.poses[0, step],
        speed=max(speed, 0.0),
        acceleration=float(motion.acceleration[0, step]),
        curvature=float(motion.yaw_rate[0, step]) / speed if abs(speed) > 0.1 else 0.0,
    )


def joined(motions: list[Motion]) -> Motion:
    """Motions that each begin where the one before ends, as one."""
    parts = [motions[0], *(_cut(motion, slice(1, None)) for motion in motions[1:])]
    return Motion(*(np.concatenate([getattr(p, n) for p in parts], axis=1) for n in QUANTITIES))


def comfortable_stretches(driven: Motion) -> list[bool]:
    """Whether each stretch of 4 s is comfortable, one after the other; what is left over is judged
    with what was before it, as a stretch that ends with the drive. A shorter drive has none.
    """
    last = driven.speed.shape[1] - 1 - STEPS
    begins = sorted({*range(0, last + 1, STEPS), last} if last >= 0 else ())
    return [bool(comfort(_cut(driven, slice(b, b + STEPS + 1)))[0]) for b in begins]


def _cut(motion: Motion, steps: slice) -> Motion:
    return Motion(*(getattr(motion, name)[:, steps] for name in QUANTITIES))
