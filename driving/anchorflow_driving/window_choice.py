"""Choose the windows of a log: vehicles and frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.geometry import (
    Array,
    Booleans,
    arc_lengths,
    at_places,
    box_corners,
    boxes_overlap,
)
from anchorflow_driving.log import (
    COMMANDS,
    FRAME_S,
    FUTURE_FRAMES,
    HISTORY_FRAMES,
    VEHICLE,
    DrivingLog,
    window_fields,
)
from anchorflow_driving.pdm.score import tracked
from anchorflow_driving.pdm.sub_scores import rate
from anchorflow_driving.pdm.traffic import recorded_traffic
from anchorflow_driving.road import DrivableGrid
from anchorflow_driving.window import Scenes, Window

EGO_LENGTH = (3.4, 7.0)  # m
MOVING = 5.0  # m in the recorded future
TURNING = np.deg2rad(20.0)
COMMAND_M = (15.0, 60.0)
"""Least and greatest distance that the command looks along the route, m."""
COMMAND_BEYOND = 10.0  # m past the end of the recorded future
STRIDE, TURNING_STRIDE = 10, 5  # frames
STANDING_SHARE = 0.04
JUMP_ACCELERATION, JUMP_YAW_RATE = 7.0, 1.2  # m/s², rad/s
LATERAL_ACCELERATION = 4.5  # m/s²
ROUTE_BEFORE, ROUTE_BEYOND = 20.0, 60.0  # m


@dataclass(frozen=True, eq=False)
class Driven:
    """A vehicle's track and the centreline that it followed."""

    track: int
    kind: int
    line: Array  # [V, 2] every 0.25 m
    place: Array  # [F] where on it the box's middle was, m; NaN where absent
    speed_limit: Array  # [F] m/s
    asked: Booleans | None = None  # [F] where a window may begin; everywhere, if None


@dataclass(frozen=True)
class _Candidate:
    driven: Driven
    frame: int
    kind: str  # turning, moving, standing


def choose_windows(
    log: DrivingLog, driven: Sequence[Driven], rng: np.random.Generator, *, most: int
) -> tuple[DrivingLog, Counter[str]]:
    """The log with at most `most` windows, a third of them turning, few standing.

    Their recorded futures are good, and stay so when a vehicle tracks them. Counted are windows,
    turning, moving and standing ones, commands, and what was dropped by its reason.
    """
    counts: Counter[str] = Counter()
    by_kind = _sound(log, driven, counts)
    chosen = _drawn(log, by_kind, rng, counts, most=most)
    counts.update(candidate.kind for candidate in chosen)
    counts["windows"] = len(chosen)
    whole = _with_windows(log, chosen)
    counts.update(COMMANDS[index] for index in whole.window_command)
    return whole, counts


def all_windows(log: DrivingLog, driven: Sequence[Driven]) -> tuple[DrivingLog, Counter[str]]:
    """The log with every window whose recorded future is good: of recorded traffic.

    A vehicle is asked about every second, while turning every half second. Counted are windows and
    what was dropped.
    """
    counts: Counter[str] = Counter()
    by_kind = _sound(log, driven, counts)
    found = [each for kind in by_kind.values() for each in kind]
    chosen = sorted(found, key=lambda each: (each.driven.track, each.frame))
    counts["windows"] = len(chosen)
    return _with_windows(log, chosen), counts


def fits_ego(length: float) -> bool:
    return EGO_LENGTH[0] <= length <= EGO_LENGTH[1]


def _sound(
    log: DrivingLog, driven: Sequence[Driven], counts: Counter[str]
) -> dict[str, list[_Candidate]]:
    """Candidates whose recorded futures are good, by their kind; the others are counted."""
    states = log.track_state.astype(np.float64)
    faults = _faults(states, log)
    by_kind: dict[str, list[_Candidate]] = {"turning": [], "moving": [], "standing": []}
    for each in driven:
        if each.kind != VEHICLE or not fits_ego(log.track_size[each.track, 0]):
            continue
        for candidate in _candidates(each, states[each.track]):
            future = slice(candidate.frame, candidate.frame + FUTURE_FRAMES + 1)
            reasons = [name for name, bad in faults.items() if bad[each.track, future].any()]
            if reasons:
                counts[f"dropped: {reasons[0]}"] += 1
            else:
                by_kind[candidate.kind].append(candidate)
    return by_kind


def _candidates(driven: Driven, states: Array) -> list[_Candidate]:
    present = np.isfinite(states[:, 0])
    found = []
    for frame in range(HISTORY_FRAMES, len(states) - FUTURE_FRAMES, TURNING_STRIDE):
        end = frame + FUTURE_FRAMES
        if not present[frame - HISTORY_FRAMES : end + 1].all():
            continue
        if not np.isfinite(driven.place[[frame, end]]).all():
            continue
        if driven.asked is not None and not driven.asked[frame]:
            continue
        turn = abs(states[end, 2] - states[frame, 2])
        moved = float(np.linalg.norm(states[end, :2] - states[frame, :2]))
        kind = "standing" if moved < MOVING else "turning" if turn > TURNING else "moving"
        if kind == "turning" or frame % STRIDE == 0:
            found.append(_Candidate(driven, frame, kind))
    return found


def _faults(states: Array, log: DrivingLog) -> dict[str, Booleans]:
    """[K, F] what makes a recorded future unfit, by reason."""
    size = log.track_size.astype(np.float64)
    grid = DrivableGrid(log.polylines("drivable"))
    corners = box_corners(np.nan_to_num(states[..., :3]), size[:, None])
    off_road = np.asarray(~grid.holds(corners).all(-1))
    speed = np.linalg.norm(states[..., 3:], axis=-1)
    acceleration = np.abs(np.gradient(speed, FRAME_S, axis=1))
    yaw_rate = np.abs(np.gradient(states[..., 2], FRAME_S, axis=1))
    return {
        "collides": _touching(states, size),
        "leaves the road": off_road,
        "jumps": np.asarray((acceleration > JUMP_ACCELERATION) | (yaw_rate > JUMP_YAW_RATE)),
        "turns too fast": np.asarray(speed * yaw_rate > LATERAL_ACCELERATION),
    }


def _touching(states: Array, size: Array) -> Booleans:
    """[K, F] the box overlaps another's."""
    touching = np.zeros(states.shape[:2], bool)
    reach = float(np.linalg.norm(size, axis=1).max())
    for frame in range(states.shape[1]):
        present = np.flatnonzero(np.isfinite(states[:, frame, 0]))
        if len(present) < 2:
            continue
        poses = states[present, frame, :3]
        one, other = KDTree(poses[:, :2]).query_pairs(reach, output_type="ndarray").T
        sizes = size[present]
        hit = boxes_overlap(poses[one], sizes[one], poses[other], sizes[other])
        touching[present[one[hit]], frame] = True
        touching[present[other[hit]], frame] = True
    return touching


def _drawn(
    log: DrivingLog,
    by_kind: Mapping[str, list[_Candidate]],
    rng: np.random.Generator,
    counts: Counter[str],
    *,
    most: int,
) -> list[_Candidate]:
    turning = _good(log, by_kind["turning"], rng, counts, most=max(1, round(most / 3)))
    few = round(most * STANDING_SHARE)
    standing = _good(log, by_kind["standing"], rng, counts, most=min(few, 2 * len(turning)))
    # Where few turn, fewer drive straight on: a third of all logs' windows shall turn.
    rest = min(2 * len(turning), most - len(turning)) - len(standing)
    chosen = [*turning, *standing, *_good(log, by_kind["moving"], rng, counts, most=rest)]
    return sorted(chosen, key=lambda each: (each.driven.track, each.frame))


def _good(
    log: DrivingLog,
    candidates: Sequence[_Candidate],
    rng: np.random.Generator,
    counts: Counter[str],
    *,
    most: int,
) -> list[_Candidate]:
    """Up to `most` candidates in random order whose futures a vehicle can track."""
    order = [candidates[i] for i in rng.permutation(len(candidates))]
    scenes = Scenes(_with_windows(log, order))
    good: list[_Candidate] = []
    for candidate, window in zip(order, scenes, strict=True):
        if len(good) == most:
            break
        fault = _tracked_fault(window)
        if fault is None:
            good.append(candidate)
        else:
            counts[f"dropped: {fault}"] += 1
    return good


def _tracked_fault(window: Window) -> str | None:
    """Return the fault that the PDM score finds in the tracked recorded future, if any."""
    traffic = recorded_traffic(window)
    motion = tracked(window.recorded(PLAN_TIMES)[None], traffic.start, traffic.vehicle)
    scores = rate(motion, traffic).scores
    if scores.nc[0] < 1:
        return "collides as tracked"
    if scores.dac[0] < 1:
        return "leaves the road as tracked"
    return None if scores.c[0] else "uncomfortable as tracked"


def _with_windows(log: DrivingLog, candidates: Sequence[_Candidate]) -> DrivingLog:
    tracks = [candidate.driven.track for candidate in candidates]
    frames = [candidate.frame for candidate in candidates]
    commands = [_command(candidate) for candidate in candidates]
    limits = [candidate.driven.speed_limit[candidate.frame] for candidate in candidates]
    routes = [_route(candidate.driven) for candidate in candidates]
    return replace(log, **window_fields(tracks, frames, commands, limits, routes))


def _command(candidate: _Candidate) -> int:
    place, frame = candidate.driven.place, candidate.frame
    return command(candidate.driven.line, float(place[frame]), float(place[frame + FUTURE_FRAMES]))


def _route(driven: Driven) -> Array:
    known = driven.place[np.isfinite(driven.place)]
    begin, last = float(known[0]) - ROUTE_BEFORE, float(known[-1]) + ROUTE_BEYOND
    return _stretch(driven.line, begin, last, spacing=1.0)


def command(line: Array, now: float, end: float) -> int:
    """Left, straight or right (index into COMMANDS) along a line from one place to another, m."""
    least, most = COMMAND_M
    length = float(np.clip(end - now + COMMAND_BEYOND, least, most))
    ahead = _stretch(line, now, now + length, spacing=1.0)
    heading = np.unwrap(np.arctan2(*np.diff(ahead, axis=0).T[::-1]))
    turn = heading[-1] - heading[0]
    return 1 if abs(turn) <= TURNING else 0 if turn > 0 else 2


def _stretch(line: Array, begin: float, end: float, *, spacing: float) -> Array:
    """The line [V, 2] from one arc length to another, as far as it goes."""
    length = arc_lengths(line)
    begin, end = max(begin, 0.0), min(end, length[-1])
    at = np.linspace(begin, end, max(2, round((end - begin) / spacing) + 1))
    return at_places(at, length, line)
