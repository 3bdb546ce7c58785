"""Futures of the other road users: the recorded ones, rules that predict them, and their judge.

A prediction has M modes for each of the A road users of `others_seen`: poses [A, M, T, 3] of
the boxes' middles at PLAN_TIMES, in the frame of the ego's rear axle now, and probabilities [A, M].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract.batch import FUTURE_PROBABILITIES, FUTURES
from anchorflow_client.sensors import HEADING, KIND, OTHERS, OTHERS_TIMES_S, VX, VY, X, Y
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.geometry import Array, arc_ends, into_frame, out_of_frame, wrap_angle
from anchorflow_driving.lane_paths import LanePaths
from anchorflow_driving.log import FRAME_S, PEDESTRIAN
from anchorflow_driving.sensors.others import tracks_seen
from anchorflow_driving.window import PlannerView, Window

MISSED_M = 2.0
"""Distance at the end beyond which a mode misses."""
MOVING_M = 2.0
"""Distance in 4 s from which a road user counts as moving."""
TURN_S = 0.5
"""Time over which a turn rate is measured."""
PACES = (0.0, -1.5, 1.0)
"""m/s² that the modes of a rule speed up by."""
SLOWEST_TURN = 1.0  # m/s; below it a turn rate is noise


@dataclass(frozen=True, eq=False)
class Futures:
    """A prediction.

    poses: [A, M, T, 3]; probabilities: [A, M], which sum to 1, or to 0 in unused rows
    """

    poses: Array
    probabilities: Array


Predictor = Callable[[PlannerView, NDArray[np.float32]], Futures]
"""A view, and `others` [A, 5, 8] of it."""


def asked_futures(client: BaseClient, inputs: Mapping[str, Any]) -> Futures:
    """Ask a bundle that predicts the others, by the inputs of its card.

    Raises `AbsentError` if the bundle gives no futures, and what `client.plan` raises.
    """
    answer = client.plan(
        inputs=inputs, outputs=[FUTURES, FUTURE_PROBABILITIES], num_samples=1, seed=0
    )
    poses, probabilities = answer.futures, answer.future_probabilities
    return Futures(poses.astype(np.float64), probabilities.astype(np.float64))


def recorded_futures(window: Window) -> Array:
    """Return poses [A, T, 3] that were recorded of `others_seen`; NaN where nothing was."""
    seen = tracks_seen(window.view)
    frames = window.frame + np.rint(PLAN_TIMES / FRAME_S).astype(int)
    known = frames < window.log.track_state.shape[1]
    poses = np.full((OTHERS, len(frames), 3), np.nan)
    recorded = window.log.track_state[seen][:, frames[known], :3].astype(np.float64)
    poses[: len(seen), known] = into_frame(recorded, window.state.pose)
    return poses


def constant_velocity_of(_: PlannerView, others: NDArray[np.float32]) -> Futures:
    """Predict one mode: all keep velocity and heading."""
    now = others[:, -1].astype(np.float64)
    ways = np.repeat(now[:, None, :3], len(PLAN_TIMES), 1)
    ways[..., :2] += PLAN_TIMES[:, None] * now[:, None, VX : VY + 1]
    return _of_modes(ways[:, None])


def constant_turn(_: PlannerView, others: NDArray[np.float32]) -> Futures:
    """Predict one mode: vehicles and cyclists keep speed and turn rate, people their velocity."""
    return _of_modes(_arcs(others, acceleration=0.0)[:, None])


def along_lanes(view: PlannerView, others: NDArray[np.float32]) -> Futures:
    """Predict six modes: up to three ways along the lanes, or else the present turn and straight
    on, each at two or three accelerations.
    """
    lanes = LanePaths(view.polylines("centre"))
    modes = np.stack([_arcs(others, acceleration=pace) for pace in PACES], 1)
    modes = np.concatenate([modes, modes], 1)
    straight = np.array(others)
    straight[:, :-1, HEADING] = straight[:, -1:, HEADING]
    modes[:, 3:] = np.stack([_arcs(straight, acceleration=pace) for pace in PACES], 1)
    for k, now in enumerate(others[:, -1].astype(np.float64)):
        if now[KIND] in (0, 1 + PEDESTRIAN) or np.hypot(now[VX], now[VY]) < SLOWEST_TURN:
            continue
        ways = lanes.ahead(now[:3], most=3)
        paces = PACES[: 3 if len(ways) < 3 else 2]
        for place, (way, pace) in enumerate((w, p) for w in ways for p in paces):
            modes[k, place] = way.poses(_distances(np.hypot(now[VX], now[VY]), pace))
    return _of_modes(modes)


RULES: dict[str, Predictor] = {
    "constant_velocity": constant_velocity_of,
    "constant_turn": constant_turn,
    "along_lanes": along_lanes,
}


def judge_futures(
    futures: Futures, recorded: Array, others: NDArray[np.float32]
) -> dict[str, NDArray[Any]]:
    """Return figures [K] of the road users that were recorded to the end.

    minADE, minFDE: m, of the mode with the smallest; miss: whether the latter is over MISSED_M;
    ADE: m, of the likeliest mode; moves: whether they moved MOVING_M; kind: as in `others`
    """
    whole = np.isfinite(recorded).all((1, 2))
    poses, truth = futures.poses[whole][..., :2], recorded[whole, None, :, :2]
    away = np.linalg.norm(poses - truth, axis=-1)
    likeliest = futures.probabilities[whole].argmax(-1)
    now = others[whole, -1]
    moved = np.linalg.norm(recorded[whole, -1, :2] - now[:, :2], axis=-1)
    last = away[..., -1].min(1)
    return {
        "minADE": away.mean(-1).min(1),
        "minFDE": last,
        "miss": (last > MISSED_M).astype(np.float64),
        "ADE": away.mean(-1)[np.arange(len(away)), likeliest],
        "moves": moved > MOVING_M,
        "kind": now[:, KIND],
    }


def _of_modes(poses: Array) -> Futures:
    """Return modes [A, M, T, 3] whose first is the likeliest."""
    likely = 1.0 / np.arange(1, poses.shape[1] + 1)
    return Futures(poses, np.tile(likely / likely.sum(), (len(poses), 1)))


def _distances(speed: Array | float, acceleration: float) -> Array:
    """Return metres [..., T] at PLAN_TIMES from speeds [...]; after braking to a halt it stays."""
    speed = np.asarray(speed)[..., None]
    time = PLAN_TIMES if acceleration >= 0 else np.minimum(PLAN_TIMES, speed / -acceleration)
    return speed * time + acceleration / 2 * time**2 * (speed > 0)


def _arcs(others: NDArray[np.float32], *, acceleration: float) -> Array:
    """Return poses [A, T, 3] at the present turn rate; people walk straight on."""
    now, before = others[:, -1].astype(np.float64), others[:, -2].astype(np.float64)
    assert OTHERS_TIMES_S[-1] - OTHERS_TIMES_S[-2] == TURN_S
    turned = wrap_angle(now[:, HEADING] - before[:, HEADING]) * (before[:, KIND] > 0)
    speed = np.hypot(now[:, VX], now[:, VY])
    drives = (now[:, KIND] != 1 + PEDESTRIAN) & (speed > SLOWEST_TURN)
    course = np.where(drives, now[:, HEADING], np.arctan2(now[:, VY], now[:, VX]))
    backwards = drives & (now[:, VX] * np.cos(course) + now[:, VY] * np.sin(course) < 0)
    course = np.where(backwards, course + np.pi, course)
    curvature = np.where(drives, turned / TURN_S / np.maximum(speed, SLOWEST_TURN), 0.0)
    distance = _distances(speed, acceleration)
    turn = curvature[:, None] * distance
    frame = np.stack([now[:, X], now[:, Y], course], -1)
    poses = out_of_frame(arc_ends(distance, turn), frame[:, None])
    poses[..., 2] = now[:, None, HEADING] + turn
    return poses
