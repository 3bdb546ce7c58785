"""Stops: along the paths of plans, and what every motion brakes to after the horizon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.guard.motion import FINE_S, FineMotion, Legs

DECELERATIONS = (2.0, 4.0, 7.0)
"""m/s^2 of the stops that are tried: comfortable, firm, hard."""
FALLBACK = 6.0
"""m/s^2 of the braking that has to be possible after the horizon."""


def stops_along(legs: Legs, speed: float, times: FloatArray, *, late_s: float = 0.0) -> FloatArray:
    """Return stops [3 N,T,3] along the paths of N plans, the gentlest of all first.

    Each stands within the time of a plan, so a fast car brakes harder than DECELERATIONS say.

    speed: m/s as the braking begins, `late_s` s from now at the end of the first leg, or now
    times: [T] s of the poses from then on
    """
    rates = [max(least, speed / (times[-1] - FINE_S)) for least in DECELERATIONS]
    begin = np.hypot(*legs.poses[:, 1, :2].T)[:, None] if late_s else 0.0
    ways = [begin + _braked(times, np.full((len(legs.poses), 1), speed), rate) for rate in rates]
    return np.concatenate([along_path(legs.poses, way) for way in ways])


def braking_after(motion: FineMotion, horizon_s: float) -> FineMotion:
    """Return motions that brake by FALLBACK from a time on, unless they brake harder already."""
    times, poses = motion.times, motion.poses
    at = int(np.floor(horizon_s / FINE_S + 1e-6))
    moved = np.hypot(*np.moveaxis(np.diff(poses[..., :2], axis=1), -1, 0))
    way = np.concatenate([np.zeros_like(moved[:, :1]), moved.cumsum(1)], 1)
    speed = moved[:, at - 1 : at + 1].max(1, keepdims=True) / FINE_S
    later = way[:, at : at + 1] + _braked(times[at:] - times[at], speed, FALLBACK)
    slowed = along_path(poses, np.minimum(way[:, at:], later))
    along, across = (
        np.where(np.arange(len(times)) < at, each, each[:, at:].max(1, keepdims=True))
        for each in (motion.along, motion.across)
    )
    poses = np.concatenate([poses[:, :at], slowed], 1)
    return replace(motion, poses=poses, along=along, across=across)


def along_path(poses: FloatArray, distance: FloatArray) -> FloatArray:
    """Return poses [N,M,3] at distances [N,M] m along paths [N,K,3], no farther than their ends.

    The distances of a path do not fall.
    """
    moved = np.zeros((*distance.shape, 3))
    _along_path(np.ascontiguousarray(poses), np.ascontiguousarray(distance), moved)
    return moved


@compiled
def _along_path(poses, distance, moved):
    """Write the poses."""
    last = poses.shape[1] - 1
    for n in range(len(poses)):
        leg, begin = 0, 0.0
        for m in range(distance.shape[1]):
            while True:
                x = poses[n, leg + 1, 0] - poses[n, leg, 0]
                y = poses[n, leg + 1, 1] - poses[n, leg, 1]
                length = np.sqrt(x * x + y * y)
                if distance[n, m] <= begin + length or leg + 1 == last:
                    break
                begin += length
                leg += 1
            share = min(max((distance[n, m] - begin) / max(length, 1e-9), 0.0), 1.0)
            for part in range(3):
                first, second = poses[n, leg, part], poses[n, leg + 1, part]
                moved[n, m, part] = first + share * (second - first)


def _braked(times: FloatArray, speed: FloatArray, deceleration: float) -> FloatArray:
    """Return the ways [N,S] m of cars at speeds [N,1] that brake until they stand."""
    moving = np.minimum(times, speed / deceleration)
    return speed * moving - 0.5 * deceleration * moving**2
