"""The one format of recorded and simulated driving: an `.npz` without pickles.

Metres, radians, seconds, in a map frame of the log's own: right-handed, heading counter-clockwise
from x. K tracks, F frames, W windows; a family of polylines or polygons is its points and L + 1
offsets, the k-th being points[offsets[k]:offsets[k + 1]].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_driving.errors import UNREADABLE, LogError, place_to_write
from anchorflow_driving.geometry import Array
from anchorflow_driving.recorded_sensors import RecordedSensors, read_sensors
from anchorflow_trajectory.car.course import SAME_POINT, without_repeats

FRAME_S = 0.1
HISTORY_FRAMES = 20
"""Recorded before a window's frame, at least."""
FUTURE_FRAMES = 45
"""Recorded after a window's frame, at least."""

FARTHEST = 1e4
"""m from the frame's origin in x or y, where float32 has steps of a millimetre."""

VEHICLE, PEDESTRIAN, CYCLIST, STATIC = range(4)
COMMANDS = ("left", "straight", "right")

SIMULATED, DRIVEN = "simulated", "driven"
"""`source` of simulated traffic, and of what a planner under test drove in it."""

Polylines = tuple[Array, ...]
"""Each [V, 2]."""

POLYGONS = ("lane", "drivable", "crosswalk")

TEXTS = ("name", "source", "licence", "city")
# Field: dtype and shape. A letter is alike wherever it stands; n and m are the field's own.
LAYOUT: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "name": ("str", ()),
    "source": ("str", ()),
    "licence": ("str", ()),
    "city": ("str", ()),
    "dt": ("float32", ()),
    "track_type": ("uint8", ("K",)),
    "track_size": ("float32", ("K", 2)),
    "track_state": ("float32", ("K", "F", 5)),
    "lane_points": ("float32", ("n", 2)),
    "lane_offsets": ("int32", ("L+1",)),
    "lane_intersection": ("bool", ("L",)),
    "lane_edges": ("int32", ("n", 2)),
    "centre_points": ("float32", ("n", 2)),
    "centre_offsets": ("int32", ("L+1",)),
    "drivable_points": ("float32", ("n", 2)),
    "drivable_offsets": ("int32", ("n",)),
    "crosswalk_points": ("float32", ("n", 2)),
    "crosswalk_offsets": ("int32", ("n",)),
    "line_points": ("float32", ("n", 2)),
    "line_offsets": ("int32", ("S+1",)),
    "line_solid": ("bool", ("S",)),
    "window_ego": ("int32", ("W",)),
    "window_frame": ("int32", ("W",)),
    "window_command": ("uint8", ("W",)),
    "window_speed_limit": ("float32", ("W",)),
    "route_points": ("float32", ("n", 2)),
    "route_offsets": ("int32", ("W+1",)),
}

TOKENS = "frame_token"
"""A field that only logs of recordings with tokens have."""


@dataclass(frozen=True, eq=False)
class DrivingLog:
    """A recording of traffic on a map, and the windows of it that a planner is asked about.

    Raises `LogError` if a field has another dtype, shape or range.
    """

    name: str
    source: str
    licence: str
    city: str
    dt: float  # s between frames, 0.1
    track_type: NDArray[np.uint8]  # [K] VEHICLE, PEDESTRIAN, CYCLIST or STATIC; track 0 recorded
    track_size: NDArray[np.float32]  # [K, 2] length, width
    track_state: NDArray[np.float32]  # [K, F, 5] x, y, heading, vx, vy of the box's middle, or NaN
    lane_points: NDArray[np.float32]  # polygons
    lane_offsets: NDArray[np.int32]
    lane_intersection: NDArray[np.bool_]  # [L] belongs to a junction
    lane_edges: NDArray[np.int32]  # [E, 2] the second lane follows the first
    centre_points: NDArray[np.float32]  # the lanes' centrelines, in driving direction
    centre_offsets: NDArray[np.int32]
    drivable_points: NDArray[np.float32]  # rings; inside an odd number of them one may drive
    drivable_offsets: NDArray[np.int32]
    crosswalk_points: NDArray[np.float32]  # polygons
    crosswalk_offsets: NDArray[np.int32]
    line_points: NDArray[np.float32]  # painted lines
    line_offsets: NDArray[np.int32]
    line_solid: NDArray[np.bool_]  # [S]
    window_ego: NDArray[np.int32]  # [W] track
    window_frame: NDArray[np.int32]  # [W] now
    window_command: NDArray[np.uint8]  # [W] index into COMMANDS
    window_speed_limit: NDArray[np.float32]  # [W] m/s, NaN where unknown
    route_points: NDArray[np.float32]  # a centreline a window
    route_offsets: NDArray[np.int32]
    frame_token: NDArray[np.str_] | None = None  # [F] the recording's, "" between its frames
    sensors: RecordedSensors | None = None  # of track 0, the only ego then
    path: str = "a log in memory"
    """The file that it was read from, for messages."""

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for field in LAYOUT:
            if field not in TEXTS:
                self._check_layout(field, sizes)
        for field in LAYOUT:
            if field.endswith("_offsets"):
                self._check_offsets(field)
        self._check_values()
        self._check_windows()
        if self.frame_token is not None:
            kind, shape = self.frame_token.dtype.kind, self.frame_token.shape
            if kind != "U" or shape != (self.frames,):
                found = f"{self.frame_token.dtype} {[*shape]}"
                raise self.refuse(TOKENS, f"texts [{self.frames}]", found)
        if self.sensors is not None:
            self.sensors.check(self.path, self.frames)
            if self.window_ego.any():
                raise self.refuse("window_ego", "0, whose sensors these are", self.window_ego.max())

    @property
    def frames(self) -> int:
        return self.track_state.shape[1]

    @property
    def windows(self) -> int:
        return len(self.window_ego)

    def polylines(self, family: str) -> Polylines:
        """The polylines or polygons of lane, centre, drivable, crosswalk, line or route."""
        points = getattr(self, f"{family}_points").astype(np.float64)
        offsets = getattr(self, f"{family}_offsets").tolist()
        return tuple(points[begin:end] for begin, end in pairwise(offsets))

    def route(self, window: int) -> Array:
        """[V, 2]"""
        begin, end = self.route_offsets[window : window + 2]
        return self.route_points[begin:end].astype(np.float64)

    def refuse(self, field: str, expected: str, found: object) -> LogError:
        return LogError(self.path, field, expected=expected, found=str(found))

    def _check_layout(self, field: str, sizes: dict[str, int]) -> None:
        dtype, axes = LAYOUT[field]
        array = np.asarray(getattr(self, field), None if field != "dt" else np.float32)
        if array.dtype != dtype:
            raise self.refuse(field, dtype, array.dtype)
        if array.ndim != len(axes):
            raise self.refuse(field, _shape(axes), list(array.shape))
        for axis, size in zip(axes, array.shape, strict=True):
            if isinstance(axis, int):
                fits = size == axis
            elif axis == "n":
                fits = True
            else:
                letter, more = axis[0], axis.endswith("+1")
                fits = sizes.setdefault(letter, size - more) == size - more >= 0
            if not fits:
                known = ", ".join(f"{name} = {size}" for name, size in sizes.items())
                raise self.refuse(field, f"{_shape(axes)} with {known}", list(array.shape))

    def _check_offsets(self, field: str) -> None:
        offsets = getattr(self, field)
        points = len(getattr(self, field.replace("_offsets", "_points")))
        if not (len(offsets) and offsets[0] == 0 and offsets[-1] == points):
            ends = list(offsets[[0, -1]]) if len(offsets) else "none"
            raise self.refuse(field, f"offsets from 0 to {points}", ends)
        least = 3 if field.removesuffix("_offsets") in POLYGONS else 2
        if (np.diff(offsets) < least).any():
            raise self.refuse(field, f"at least {least} points each", int(np.diff(offsets).min()))

    def _check_values(self) -> None:
        if not np.isclose(self.dt, FRAME_S, atol=1e-6):
            raise self.refuse("dt", f"{FRAME_S} s", self.dt)
        if not ((self.track_size > 0) & np.isfinite(self.track_size)).all():
            found = f"{self.track_size.min()} to {self.track_size.max()}"
            raise self.refuse("track_size", "lengths and widths above 0", found)
        for field in (name for name in LAYOUT if name.endswith("_points")):
            if not np.isfinite(getattr(self, field)).all():
                raise self.refuse(field, "finite numbers", "NaN or infinity")
            self._check_places(field, getattr(self, field))
        if np.isinf(self.track_state).any():
            raise self.refuse("track_state", "finite numbers, or NaN where absent", "infinity")
        absent = np.isnan(self.track_state)
        if (absent.any(-1) != absent.all(-1)).any():
            raise self.refuse("track_state", "NaN in all five numbers or in none", "some")
        self._check_places("track_state", self.track_state[..., :2])
        self._check_range("track_type", STATIC)
        self._check_range("lane_edges", len(self.lane_intersection) - 1)

    def _check_windows(self) -> None:
        self._check_range("window_ego", len(self.track_type) - 1)
        self._check_range("window_command", len(COMMANDS) - 1)
        last, least = self.frames - 1 - FUTURE_FRAMES, HISTORY_FRAMES + 1 + FUTURE_FRAMES
        if self.windows and self.frames < least:
            raise self.refuse("track_state", f"at least {least} frames for a window", self.frames)
        self._check_range("window_frame", last, least=HISTORY_FRAMES)
        limit = self.window_speed_limit[~np.isnan(self.window_speed_limit)]
        if not ((limit > 0) & np.isfinite(limit)).all():
            raise self.refuse(
                "window_speed_limit",
                "m/s above 0, or NaN where unknown",
                f"{limit.min()} to {limit.max()}",
            )
        for window, route in enumerate(self.polylines("route")):
            if len(without_repeats(route)) < 2:
                raise self.refuse(
                    "route_points",
                    "a route of some length",
                    f"window {window}: no step above {SAME_POINT} m",
                )
        for window, (ego, frame) in enumerate(zip(self.window_ego, self.window_frame, strict=True)):
            needed = self.track_state[ego, frame - HISTORY_FRAMES : frame + FUTURE_FRAMES + 1]
            if not np.isfinite(needed).all():
                raise self.refuse(
                    "track_state",
                    f"the ego of window {window} from {HISTORY_FRAMES} frames before it to"
                    f" {FUTURE_FRAMES} after",
                    f"NaN in {int(np.isnan(needed).any(-1).sum())} of them",
                )

    def _check_places(self, field: str, places: NDArray[np.float32]) -> None:
        far = np.abs(places)
        far = far[far > FARTHEST]
        if far.size:
            raise self.refuse(
                field,
                f"x and y within {FARTHEST:g} m of 0, for float32",
                f"{far.max():.0f} m",
            )

    def _check_range(self, field: str, most: int, *, least: int = 0) -> None:
        values = getattr(self, field)
        wrong = values[(values < least) | (values > most)]
        if wrong.size:
            raise self.refuse(field, f"{least} to {most}", wrong.flat[0])


def read_log(path: Path | str) -> DrivingLog:
    """A log of a file.

    Raises `LogError` if the file cannot be read, or a field is missing or wrong.
    """
    arrays = _read_arrays(path)
    values: dict[str, Any] = dict(arrays)
    for field, (dtype, axes) in LAYOUT.items():
        if not axes:
            array = arrays[field]
            kind = "str" if array.dtype.kind == "U" else str(array.dtype)
            if kind != dtype or array.shape != ():
                found = f"{kind} {list(array.shape)}"
                raise LogError(path, field, expected=f"{dtype} []", found=found)
            values[field] = array.item()
    return DrivingLog(**values, sensors=read_sensors(path), path=str(path))


def write_log(log: DrivingLog, path: Path | str) -> None:
    """Writes what `read_log` reads. Raises `LogError` if the file cannot be written."""
    arrays: dict[str, Any] = {
        field.name: getattr(log, field.name) for field in fields(log) if field.name in LAYOUT
    }
    arrays["dt"] = np.float32(log.dt)
    if log.frame_token is not None:
        arrays[TOKENS] = log.frame_token
    arrays |= {} if log.sensors is None else log.sensors.arrays()
    with place_to_write(path), Path(path).open("wb") as file:
        np.savez_compressed(file, **arrays)


def open_logs(folder: Path | str) -> list[Path]:
    """The logs of a folder, by file name. Raises `LogError` if there are none."""
    logs = sorted(Path(folder).glob("*.npz"))
    if not logs:
        raise LogError(folder, "folder", expected="logs (*.npz)", found="none")
    return logs


def read_logs(folder: Path | str) -> list[DrivingLog]:
    """The logs of a folder. Raises `LogError` if there are none, or one cannot be read."""
    return [read_log(path) for path in open_logs(folder)]


def _read_arrays(path: Path | str) -> dict[str, NDArray]:
    """Return every field's array, whatever it holds."""
    try:
        with Path(path).open("rb") as stream:
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("a single array")
            missing = [field for field in LAYOUT if field not in file.files]
            if missing:
                raise LogError(path, missing[0], expected="the field", found="none")
            told = [*LAYOUT, *([TOKENS] if TOKENS in file.files else [])]
            return {field: _array(path, field, file) for field in told}
    except UNREADABLE as error:
        raise LogError(path, "file", expected="an .npz of arrays", found=str(error)) from error


def _array(path: Path | str, field: str, file: Mapping[str, NDArray]) -> NDArray:
    try:
        array = file[field]
    except ValueError as error:  # an array of objects, which only a pickle could hold
        expected = LAYOUT.get(field, ("str",))[0]
        raise LogError(path, field, expected=expected, found=str(error)) from error
    if not isinstance(array, np.ndarray):  # numpy gives the bytes of what is no array
        raise LogError(path, field, expected="an array", found="other bytes")
    return array


def _shape(axes: tuple[str | int, ...]) -> str:
    return f"[{', '.join(map(str, axes))}]"


def line_fields(name: str, lines: Sequence[Array], *, mirror: float = 1.0) -> dict[str, Any]:
    """`NAME_points` and `NAME_offsets` of polylines [V, 2]; y is multiplied by `mirror`."""
    offsets = np.cumsum([0, *(len(line) for line in lines)]).astype(np.int32)
    points = np.concatenate([*lines, np.zeros((0, 2))]) * [1.0, mirror]
    return {f"{name}_points": points.astype(np.float32), f"{name}_offsets": offsets}


def window_fields(
    egos: ArrayLike,
    frames: ArrayLike,
    commands: ArrayLike,
    limits: ArrayLike,
    routes: Sequence[Array],
) -> dict[str, Any]:
    """Return a log's fields of W windows."""
    return {
        "window_ego": np.array(egos, np.int32),
        "window_frame": np.array(frames, np.int32),
        "window_command": np.array(commands, np.uint8),
        "window_speed_limit": np.array(limits, np.float32),
        **line_fields("route", routes),
    }


NO_WINDOWS = window_fields([], [], [], [], [])


@dataclass(frozen=True, eq=False)
class Lane:
    name: str
    polygon: Array  # [V, 2]
    centre: Array  # [V, 2] in driving direction
    successors: Sequence[str]  # names; those of no lane are left out
    in_junction: bool


@dataclass(frozen=True, eq=False)
class RoadMap:
    lanes: Sequence[Lane]
    drivable: Sequence[Array]  # rings; inside an odd number of them one may drive
    crosswalks: Sequence[Array]
    lines: Sequence[tuple[Array, bool]]  # painted lines, and whether they are solid

    def fields(self, *, origin: Array | float = 0.0, mirror: float = 1.0) -> dict[str, Any]:
        """Return a log's fields: `origin` becomes (0, 0), y is multiplied by `mirror`."""
        number = {lane.name: index for index, lane in enumerate(self.lanes)}
        edges = [
            (number[lane.name], number[after])
            for lane in self.lanes
            for after in lane.successors
            if after in number
        ]
        families = {
            "lane": [lane.polygon for lane in self.lanes],
            "centre": [lane.centre for lane in self.lanes],
            "drivable": self.drivable,
            "crosswalk": self.crosswalks,
            "line": [line for line, _ in self.lines],
        }
        found: dict[str, Any] = {
            "lane_intersection": np.array([lane.in_junction for lane in self.lanes], bool),
            "lane_edges": np.array(edges, np.int32).reshape(-1, 2),
            "line_solid": np.array([solid for _, solid in self.lines], bool),
        }
        for name, lines in families.items():
            found |= line_fields(name, [line - origin for line in lines], mirror=mirror)
        return found


def track_fields(
    kinds: ArrayLike, sizes: ArrayLike, states: NDArray[np.floating]
) -> dict[str, Any]:
    """Return a log's fields of tracks, with states [K, F, 5]."""
    return {
        "track_type": np.array(kinds, np.uint8),
        "track_size": np.array(sizes, np.float32),
        "track_state": states.astype(np.float32),
    }
