"""Evasive manoeuvres: swerve as hard as a robot may, and then brake or go on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.spline.basis import PLANE, Ends, SplineBasis, Splines

DIRECTIONS, PUSHES_S = 24, (0.3, 0.6, 1.0)  # s of pushing to a side
SHARE = 0.94  # of the limits
TICK_S = 0.025  # of a drive
CHANGE_S, SPANS = 0.1, 1.5  # s, or spans of a spline, in which an acceleration changes at least
STAY_S = 0.3  # after the longest drive, without a horizon
TINY = 1e-9


def evasions(basis: SplineBasis, ends: Ends, limits: MotionLimits) -> Splines:
    """Return splines that swerve or brake, until the horizon or until who brakes has stopped.

    They have the place and velocity of the start of `ends`, an acceleration of their own from the
    first moment, since the one that leads into somebody is of no use, and ends of their own.
    """
    position, velocity = ends.x_curr.reshape(3, -1)[:2, PLANE].astype(np.float64)
    stopping = limits.v_max / limits.a_max + CHANGE_S
    whole = limits.horizon_s or max(PUSHES_S) + stopping + STAY_S
    change = max(CHANGE_S, SPANS * whole / (basis.num_control_points - basis.degree))
    begun, drive = _drives(position, velocity, limits, whole, round(change / TICK_S))
    tick = np.linspace(0.0, whole / TICK_S, basis.num_samples)
    low = np.minimum(tick.astype(int), drive.shape[1] - 2)
    share = (tick - low)[:, None]  # beyond 1 where the drives go on evenly
    places = (1.0 - share) * drive[:, low] + share * drive[:, low + 1]
    ended = (drive[:, low[-1] + 1] - drive[:, low[-1]]) / TICK_S
    # A spline is linear in its ends: those of each are taken off for the fit and added afterwards.
    lasting = np.full(len(places), whole)
    own = np.stack([begun, places[:, -1], ended], 1)  # [N, 3, 2]
    units = [Ends(unit[:6], unit[6:]) for unit in np.repeat(np.eye(5)[2:], 2, axis=1)]
    shapes = np.stack([basis.rest_curves(unit, lasting[:1]).control[0, 0] for unit in units])
    moved = np.einsum("ndc,dk->cnk", own, shapes)
    still = Ends(np.concatenate([position, velocity, np.zeros(2)]), np.zeros(4))
    left = places - np.einsum("cnk,tk->ntc", moved, basis.position)
    control = basis.fit_positions(left.astype(np.float32), still, lasting).control
    control += moved.astype(np.float32)
    if len(ends.x_goal) // 2 == PLANE.stop:
        return Splines(control, lasting)
    turned = basis.rest_curves(ends, lasting)
    turned.control[PLANE] = control
    return turned


def _drives(
    position: FloatArray, velocity: FloatArray, limits: MotionLimits, lasting: float, change: int
) -> tuple[FloatArray, NDArray[np.float64]]:
    """Return accelerations [N, 2] at the start, and places [N, S, 2] at ticks, of manoeuvres.

    The first brakes straight on. The others push to a side; half of them then brake, and half keep
    their speed. From the last tick on, all move as in it.

    change: ticks in which an acceleration changes
    """
    turns = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    sides = np.stack([np.cos(turns), np.sin(turns)], -1)
    pushes = np.tile(sides, (2 * len(PUSHES_S), 1))
    until = np.tile(np.repeat(PUSHES_S, DIRECTIONS), 2)
    brakes = np.arange(len(pushes)) < len(pushes) // 2
    speed, hard = float(np.linalg.norm(velocity)), SHARE * limits.a_max
    pushes = np.concatenate([-velocity[None] / max(speed, TINY), pushes])
    until, brakes = np.append(0.0, until)[:, None], np.append(True, brakes)[:, None]
    begun, most = hard * pushes, max(SHARE * limits.v_max, speed)
    # The mean over the last ticks has no kinks, and begins as told.
    blur = TICK_S * change
    at = position + 0.5 * blur * velocity + blur**2 / 12.0 * begun
    now = velocity + 0.5 * blur * begun
    before = TICK_S * np.arange(-change, 0)[:, None, None]
    places = [*(at + before * now + 0.5 * before**2 * begun), at]
    last = min(lasting, max(PUSHES_S) + most / hard + blur)
    for time in np.arange(0.0, last + TICK_S, TICK_S):
        pushed = now + TICK_S * hard * pushes
        pushed *= np.minimum(1.0, most / np.maximum(_lengths(pushed), TINY))
        kept = np.maximum(1.0 - TICK_S * hard / np.maximum(_lengths(now), TINY), 0.0)
        then = np.where(time < until, pushed, np.where(brakes, kept, 1.0) * now)
        at = at + 0.5 * TICK_S * (now + then)
        now = then
        places.append(at)
    driven = np.stack(places, 1)
    summed = np.cumsum(0.5 * (driven[:, 1:] + driven[:, :-1]), axis=1)
    summed = np.concatenate([np.zeros_like(summed[:, :1]), summed], axis=1)
    return begun, (summed[:, change:] - summed[:, :-change]) / change


def _lengths(vectors: FloatArray) -> FloatArray:
    return np.linalg.norm(vectors, axis=-1, keepdims=True)
