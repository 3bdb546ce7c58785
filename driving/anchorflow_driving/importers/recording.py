"""Turn imported tracks and a map into a driving log with its windows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import Array, at_places
from anchorflow_driving.importers.fields import Entry
from anchorflow_driving.importers.lane_following import LaneFollowing
from anchorflow_driving.importers.sensor_files import SensorFiles
from anchorflow_driving.log import FRAME_S, NO_WINDOWS, VEHICLE, DrivingLog, RoadMap, track_fields
from anchorflow_driving.window_choice import all_windows

CLOSED_GAP = 1.0
"""s between two states, up to which a track is interpolated."""
AROUND = 80.0
"""m around the tracks in which a map is kept: a route goes 60 m past the record."""
_SLACK = 1e-6  # s


@dataclass(frozen=True, eq=False)
class Track:
    """The recorded states of one object, at its own times."""

    kind: int  # VEHICLE, PEDESTRIAN, CYCLIST or STATIC
    size: tuple[float, float]  # length, width
    time: Array  # [M] s, growing from 0
    poses: Array  # [M, 3] x, y, heading of the box's middle; headings may jump by 2 pi
    velocity: Array  # [M, 2]
    always: bool = False  # present in every frame, at its only state


def recorded_log(
    tracks: Sequence[Track],
    road: RoadMap,
    *,
    name: str,
    source: str,
    path: Path,
    licence: str,
    city: str = "",
    origin: Array | None = None,
    sensors: SensorFiles | None = None,
    tokens: Mapping[float, str] | None = None,
) -> tuple[DrivingLog, Counter[str]]:
    """The log at 10 Hz, with every window whose recorded future is good, and what was counted.

    origin: [2] what becomes (0, 0); far from it, float32 is too coarse
    sensors: of track 0, which is the only ego then, where its files are near
    tokens: of the recording's frames, by their times in s

    Raises `LogError` if a file of sensors that a window needs is missing.
    """
    origin = np.zeros(2) if origin is None else origin
    now = frame_times(max(track.time[-1] for track in tracks))
    sensed = None if sensors is None else sensors.at(now, origin=origin)
    log = DrivingLog(
        name=name,
        source=source,
        licence=licence,
        city=city,
        dt=FRAME_S,
        **_track_fields(tracks, now, origin),
        **road.fields(origin=origin),
        **NO_WINDOWS,
        frame_token=None if tokens is None else _frame_tokens(tokens, len(now)),
        sensors=sensed,
        path=str(path),
    )
    counts: Counter[str] = Counter()
    matched, found = LaneFollowing(log), []
    vehicles = np.flatnonzero(log.track_type == VEHICLE).tolist()
    for track in vehicles if sensed is None else vehicles[:1]:
        line = matched.driven(track, log.track_state[track].astype(np.float64))
        if line is None:
            counts["dropped: vehicle off the lanes"] += 1
        else:
            found.append(line if sensed is None else replace(line, asked=sensed.complete))
    log, chosen = all_windows(log, found)
    if sensed is not None:
        counts["frames with sensors"] = int(sensed.complete.sum())
        sensed.check_files(log.window_frame.tolist())
    return log, counts + chosen


def _frame_tokens(tokens: Mapping[float, str], frames: int) -> NDArray[np.str_]:
    """Return the token of the recorded frame at each frame [F], "" where there is none."""
    nearest = {round(time / FRAME_S): token for time, token in tokens.items()}
    return np.array([nearest.get(frame, "") for frame in range(frames)])


def frame_times(seconds: float) -> Array:
    """Return the times of the log's frames from 0 to `seconds`."""
    frames = 1 + int(np.floor(seconds / FRAME_S + _SLACK))
    return np.array([FRAME_S * frame for frame in range(frames)])


def resampled_poses(time: Array, poses: Array, now: Array) -> Array:
    """Poses [M, 3] at other times; headings turn the short way."""
    return at_places(now, time, np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]))


def velocities(time: Array, positions: Array) -> Array:
    """[M, 2] by central differences; M >= 2."""
    return np.gradient(positions, time, axis=0)


def flat_pose(place: Entry, turn: Entry) -> Array:
    """[3] x, y, heading of a place x, y, z and a unit quaternion w, x, y, z."""
    x, y, _ = place.numbers(3)
    w, i, j, k = turn.numbers(4)
    return np.array([x, y, np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))])


def surroundings(tracks: Sequence[Track]) -> tuple[Array, Array]:
    """The low and the high corner of where a map is needed."""
    places = np.concatenate([track.poses[:, :2] for track in tracks])
    return places.min(0) - AROUND, places.max(0) + AROUND


def is_near(points: Array, box: tuple[Array, Array]) -> bool:
    """Whether the bounds of some points [V, 2] touch a box, low and high."""
    low, high = box
    return bool((points.min(0) <= high).all() and (points.max(0) >= low).all())


def _track_fields(tracks: Sequence[Track], now: Array, origin: Array) -> dict[str, Any]:
    frames = len(now)
    states = np.full((len(tracks), frames, 5), np.nan)
    for state, track in zip(states, tracks, strict=True):
        seen = np.ones(frames, bool) if track.always else _seen(track.time, now)
        poses = resampled_poses(track.time, track.poses, now[seen])
        velocity = at_places(now[seen], track.time, track.velocity)
        state[seen] = np.concatenate([poses - [*origin, 0.0], velocity], axis=1)
    return track_fields([track.kind for track in tracks], [track.size for track in tracks], states)


def _seen(time: Array, now: Array) -> NDArray[np.bool_]:
    """Return which frames coincide with a state or fall into a short gap."""
    before = np.searchsorted(time, now + _SLACK, side="right") - 1
    after = np.searchsorted(time, now - _SLACK, side="left")
    inside = (before >= 0) & (after < len(time))
    gap = time[np.minimum(after, len(time) - 1)] - time[np.maximum(before, 0)]
    return inside & (gap <= CLOSED_GAP + _SLACK)
