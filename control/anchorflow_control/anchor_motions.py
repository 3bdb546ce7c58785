"""Recover a robot's controls from the positions, velocities and accelerations of anchors.

An anchor becomes a reference in the form of the robot's state: forward speed and turn rate of a
robot on wheels follow from v, a and the heading. The robot's model then follows each reference,
which waits where the robot lags behind.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_client.errors import InvalidRequest
from anchorflow_control.dynamics import OMNI, SHARPEST, Limits, step, within
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

NONE, ONE, SLOW = np.float32(0.0), np.float32(1.0), np.float32(0.05)
MAX_SAMPLES = 400
EARLY = np.float32(0.02)  # m by which a sample has to be nearer than the one before it
LAG = np.float32(0.5)  # m behind, at which the reference waits
HURRY = np.float32(1.5)  # most, as a share of its own pace, that a reference runs
ALONG, ASIDE, TURN = map(np.float32, (2.0, 4.0, 3.0))  # gains: 1/s, 1/m^2, 1/s
ON_THE_SPOT = np.float32(0.8)  # rad off the heading, from which the robot turns on the spot


def check_motions(batch: AnchorBatch) -> None:
    """Raise `InvalidRequest` unless anchors of one scene have velocities and accelerations."""
    if batch.batched:
        raise InvalidRequest("expected the anchors of one scene, got a B axis", "anchors")
    dim = batch.trajectories.shape[-1]
    if dim not in (2, 3):
        raise InvalidRequest(f"expected x, y and perhaps a heading, got D = {dim}", "anchors")
    for name in ("velocities", "accelerations"):
        if name not in batch.arrays:
            raise InvalidRequest(f"expected {name} beside the trajectories, got none", "anchors")


def references(
    batch: AnchorBatch,
    chosen: NDArray[np.intp],
    place: Array,
    *,
    kind: int,
    elapsed_s: float,
    dt: float,
    least: int,
    heading: float,
) -> Floats:
    """Return [A,S,5], the chosen anchors as states of a robot, at every `dt` s from now on.

    S is the longest one's number of states, at least `least`; after its end an anchor keeps its
    last velocity.

    Args:
        batch: of one scene, with velocities and accelerations.
        chosen: [A], indices.
        place: [2] m, the origin of the states.
        kind: OMNI or WHEELS.
        elapsed_s: s since the anchors' beginning.
        dt: s between two states.
        least: samples.
        heading: rad, of the robot; an omni robot keeps it.
    """
    strides = batch.trajectories.shape[1] - 1
    steps_s = (batch.durations[chosen] / strides).astype(np.float32)
    left_s = strides * float(steps_s.max()) - elapsed_s
    count = int(np.clip(np.ceil(left_s / dt) + 1, least, MAX_SAMPLES))
    places = batch.trajectories[chosen].astype(np.float64)
    places[..., :2] -= place
    fields = (places, batch.velocities[chosen], batch.accelerations[chosen])
    p, v, a = (np.ascontiguousarray(field, np.float32) for field in fields)
    states = np.empty((len(chosen), count, 5), np.float32)
    for n in range(len(chosen)):
        timing = (steps_s[n], np.float32(elapsed_s), np.float32(dt))
        _read(p[n], v[n], a[n], timing, kind, np.float32(heading), states[n])
    return states


@compiled
def _read(
    p: Floats,
    v: Floats,
    a: Floats,
    timing: tuple[np.float32, np.float32, np.float32],
    kind: int,
    heading: np.float32,
    states: Floats,
) -> None:
    """Write one anchor [T,D] as states [S,5].

    Between two samples its way is the cubic with their positions and velocities (Hermite's).

    timing: s between samples, s since its beginning, s between states
    heading: rad, of a robot that the anchor does not move
    """
    step_s, elapsed, dt = timing
    last, turns = len(p) - 1, p.shape[1] == 3
    for s in range(len(states)):
        at = (elapsed + s * dt) / step_s
        low = min(max(int(at), 0), last - 1)
        u = np.float32(min(max(at - low, 0.0), 1.0))
        over = np.float32(max(at - last, 0.0)) * step_s
        x, vx = _cubic(p[low, 0], p[low + 1, 0], v[low, 0], v[low + 1, 0], step_s, u)
        y, vy = _cubic(p[low, 1], p[low + 1, 1], v[low, 1], v[low + 1, 1], step_s, u)
        states[s, 0], states[s, 1], states[s, 2] = x + over * vx, y + over * vy, heading
        states[s, 3], states[s, 4] = vx, vy
        if kind == OMNI:
            continue
        if turns:
            angle, turn = _cubic(p[low, 2], p[low + 1, 2], v[low, 2], v[low + 1, 2], step_s, u)
            states[s, 2] = angle + over * turn
            states[s, 3] = vx * np.cos(angle) + vy * np.sin(angle)
            states[s, 4] = turn
        else:
            speed = np.sqrt(vx * vx + vy * vy)
            states[s, 2] = np.arctan2(vy, vx) if speed > SLOW else np.float32(np.nan)
            ax = (ONE - u) * a[low, 0] + u * a[low + 1, 0]
            ay = (ONE - u) * a[low, 1] + u * a[low + 1, 1]
            bend = (vx * ay - vy * ax) / max(speed * speed, SLOW * SLOW)
            states[s, 3], states[s, 4] = speed, NONE if over > NONE else bend
    if kind != OMNI and not turns:
        _fill_headings(states, heading)


@compiled
def _cubic(
    p: np.float32, to_p: np.float32, v: np.float32, to_v: np.float32, h: np.float32, u: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the place and the velocity at a share u of the cubic between two samples h s apart."""
    by, m, to_m = to_p - p, h * v, h * to_v
    c, d = np.float32(3.0) * by - np.float32(2.0) * m - to_m, m + to_m - np.float32(2.0) * by
    place = p + u * (m + u * (c + u * d))
    return place, (m + u * (np.float32(2.0) * c + np.float32(3.0) * u * d)) / h


@compiled
def _fill_headings(states: Floats, heading: np.float32) -> None:
    """Give slow samples, whose heading is NaN, that of the next one, and at the end the last one's.

    A turn rate at such speeds is noise, and becomes 0.
    """
    later = np.float32(np.nan)
    for s in range(len(states) - 1, -1, -1):
        if np.isnan(states[s, 2]):
            states[s, 2], states[s, 4] = later, NONE
        later = states[s, 2]
    earlier = heading
    for s in range(len(states)):
        if np.isnan(states[s, 2]):
            states[s, 2] = earlier
        earlier = states[s, 2]


@compiled
def follow(
    limits: Limits,
    start: Floats,
    references: Floats,
    paces: Floats,
    dt: np.float32,
    controls: Floats,
) -> None:
    """Write the controls [A*P,T,2] with which a robot in a state [5] follows references [A,S,5].

    paces: [P], at which each is followed in turn, as shares of its own pace
    """
    for k in range(len(controls)):
        reference, haste = references[k // len(paces)], paces[k % len(paces)]
        state = (start[0], start[1], start[2], start[3], start[4])
        at, last = nearest_sample(reference, state[0], state[1]), np.float32(len(reference) - 1)
        for t in range(controls.shape[1]):
            here, there = min(at, last), min(at + haste, last)
            if limits.kind == OMNI:
                first, second, pace = _omni_pull(state, reference, here, there, haste)
            else:
                first, second, pace = _wheeled_pull(limits, state, reference, here, there, haste)
            first, second = (first - state[3]) / dt, (second - state[4]) / dt
            before = state
            state = step(limits, state, first, second, dt)
            # The change that the limits allowed.
            controls[k, t, 0] = (state[3] - before[3]) / dt
            controls[k, t, 1] = (state[4] - before[4]) / dt
            at += haste * pace


@compiled
def nearest_sample(reference: Floats, x: np.float32, y: np.float32) -> np.float32:
    """Return the sample of a reference [S,5] that is nearest to a place, an early one rather.

    An anchor of unknown age is entered where the robot is.
    """
    nearest, least = 0, np.float32(np.inf)
    for s in range(len(reference)):
        across, along = reference[s, 0] - x, reference[s, 1] - y
        apart = np.sqrt(across * across + along * along) + EARLY * np.float32(s)
        if apart < least:
            nearest, least = s, apart
    return np.float32(nearest)


@compiled
def _between(reference: Floats, at: np.float32, column: int) -> np.float32:
    low = min(int(at), len(reference) - 2)
    share = at - np.float32(low)
    return reference[low, column] + share * (reference[low + 1, column] - reference[low, column])


@compiled
def _omni_pull(
    state: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    reference: Floats,
    here: np.float32,
    there: np.float32,
    haste: np.float32,
) -> tuple[np.float32, np.float32, np.float32]:
    """Return the velocity for the end of a step, and the share that the reference advances."""
    off_x, off_y = _between(reference, here, 0) - state[0], _between(reference, here, 1) - state[1]
    vx, vy = haste * _between(reference, there, 3), haste * _between(reference, there, 4)
    speed = np.sqrt(vx * vx + vy * vy)
    behind = (off_x * vx + off_y * vy) / max(speed, SLOW)
    pace = within(ONE - behind / LAG, NONE, HURRY)
    return vx + ALONG * off_x, vy + ALONG * off_y, pace


@compiled
def _wheeled_pull(
    limits: Limits,
    state: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    reference: Floats,
    here: np.float32,
    there: np.float32,
    haste: np.float32,
) -> tuple[np.float32, np.float32, np.float32]:
    """Return speed and turn rate for the end of a step, and the share that the reference advances.

    Kanayama et al. (1990); a robot that can turn on the spot does so far off its course.
    """
    x, y, heading, _, _ = state
    cos, sin = np.cos(heading), np.sin(heading)
    off_x, off_y = _between(reference, here, 0) - x, _between(reference, here, 1) - y
    behind, left = cos * off_x + sin * off_y, cos * off_y - sin * off_x
    course = reference[int(here + np.float32(0.5)), 2] - heading
    course = np.arctan2(np.sin(course), np.cos(course))
    if limits.curvature >= SHARPEST and abs(course) > ON_THE_SPOT:
        return NONE, TURN * course, NONE
    v, w = haste * _between(reference, there, 3), haste * _between(reference, there, 4)
    ahead = behind if v >= NONE else -behind
    pace = within(ONE - ahead / LAG, NONE, HURRY)
    speed = v * np.cos(course) + ALONG * behind
    return speed, w * pace + ASIDE * v * left + TURN * np.sin(course), pace
