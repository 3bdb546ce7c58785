"""What was driven of several plans, one after the other."""

from __future__ import annotations

import numpy as np

from anchorflow_driving.pdm.comfort import comfort
from anchorflow_driving.pdm.tracker import STEPS, Motion
from anchorflow_driving.window import EgoState


def first_steps(motion: Motion, steps: int) -> Motion:
    """The motion's start and as many steps."""
    cut = slice(0, steps + 1)
    return Motion(
        motion.poses[:, cut],
        motion.speed[:, cut],
        motion.acceleration[:, cut],
        motion.yaw_rate[:, cut],
    )


def state_after(motion: Motion, step: int) -> EgoState:
    """How the only plan's vehicle moves after a step."""
    speed = float(motion.speed[0, step])
    return EgoState(
        pose=motion.poses[0, step],
        speed=max(speed, 0.0),
        acceleration=float(motion.acceleration[0, step]),
        curvature=float(motion.yaw_rate[0, step]) / speed if abs(speed) > 0.1 else 0.0,
    )


def comfortable_share(motions: list[Motion]) -> float:
    """Share of the stretches of 4 s, one after the other, that are comfortable."""
    whole = [
        np.concatenate([getattr(m, name)[:, 1:] for m in motions], axis=1)
        for name in ("poses", "speed", "acceleration", "yaw_rate")
    ]
    begins = range(0, whole[0].shape[1] - STEPS, STEPS)
    parts = [Motion(*(each[:, begin : begin + STEPS + 1] for each in whole)) for begin in begins]
    return float(np.mean([comfort(part)[0] for part in parts])) if parts else float("nan")
