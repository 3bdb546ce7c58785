"""One question to a planner: an ego, a frame, a route and a command.

Plans are poses of the ego's rear axle, in the frame of that axle now: x forward, y left, heading
counter-clockwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import Array, ahead_of, into_frame, states_into_frame, wrap_angle
from anchorflow_driving.log import COMMANDS, FRAME_S, HISTORY_FRAMES, DrivingLog, Polylines
from anchorflow_driving.recorded_sensors import RecordedSensors
from anchorflow_driving.road import Road
from anchorflow_driving.route import Route
from anchorflow_trajectory.car.tracking import EgoState

REAR_AXLE = 0.2823
"""Behind the middle of the box, in lengths: the proportions of the car that NAVSIM scores with."""
WHEELBASE = 0.5968
"""In lengths, from the same car."""
_SLOWEST_TURN = 1.0  # m/s; below it a curvature is noise


@dataclass(frozen=True)
class Vehicle:
    """A box and its axles, m."""

    length: float
    width: float

    @property
    def size(self) -> Array:
        return np.array([self.length, self.width])

    @property
    def rear_axle(self) -> float:
        """Behind the middle of the box."""
        return REAR_AXLE * self.length

    @property
    def wheelbase(self) -> float:
        return WHEELBASE * self.length

    def middles(self, axle_poses: Array) -> Array:
        """Poses [..., 3] of the box's middle from those of the rear axle."""
        return ahead_of(axle_poses, self.rear_axle)


@dataclass(frozen=True, eq=False)
class PlannerView:
    """The inputs of a planner: the past, the map, the route and the command.

    All is in the ego's frame but `state.pose` and `road`.
    """

    state: EgoState  # from the past alone
    vehicle: Vehicle
    ego: int  # track
    tracks: (
        Array  # [K, H + 1, 5] x, y, heading, vx, vy of the boxes' middles; the last frame is now
    )
    track_type: NDArray[np.uint8]  # [K]
    track_size: Array  # [K, 2] length, width
    route: Route
    command: int  # index into COMMANDS
    speed_limit: float  # m/s, NaN where unknown
    road: Road
    log_polylines: dict[str, Polylines]
    line_solid: NDArray[np.bool_]  # of the lines
    sensors: RecordedSensors | None = None  # the ego's; simulated if there are none
    frame: int = 0  # of the log, now

    def polylines(self, family: str) -> Polylines:
        """The map's lanes, centres, drivable rings, crosswalks or lines."""
        lines = self.log_polylines[family]
        moved = into_frame(np.concatenate([*lines, np.zeros((0, 2))]), self.state.pose)
        ends = np.cumsum([0, *(len(line) for line in lines)]).tolist()
        return tuple(moved[begin:end] for begin, end in pairwise(ends))


class Scenes:
    """The windows of a log, which share what is made of its map."""

    def __init__(self, log: DrivingLog) -> None:
        self.log = log

    def __len__(self) -> int:
        return self.log.windows

    def __iter__(self) -> Iterator[Window]:
        return (Window(self, index) for index in range(len(self)))

    def __getitem__(self, index: int) -> Window:
        if not 0 <= index < len(self):
            raise IndexError(f"{self.log.name} has windows 0 to {len(self) - 1}, not {index}")
        return Window(self, index)

    @cached_property
    def road(self) -> Road:
        return Road(self.log)

    @cached_property
    def map_polylines(self) -> dict[str, Polylines]:
        families = ("lane", "centre", "drivable", "crosswalk", "line")
        return {family: self.log.polylines(family) for family in families}


class Window:
    """A window with its recorded future: what a judge knows. A planner gets `view`.

    meanwhile: [K, 4] s, x, y, heading of what the ego is about to do, in its frame; None: unknown
    """

    meanwhile: Array | None = None

    def __init__(self, scenes: Scenes, index: int) -> None:
        log = scenes.log
        self.log, self.index, self.road, self._scenes = log, index, scenes.road, scenes
        self.ego, self.frame = int(log.window_ego[index]), int(log.window_frame[index])
        self.command = int(log.window_command[index])
        self.speed_limit = float(log.window_speed_limit[index])
        length, width = log.track_size[self.ego].astype(float)
        self.vehicle = Vehicle(float(length), float(width))
        self._ego_track = log.track_state[self.ego].astype(np.float64)

    @property
    def command_name(self) -> str:
        return COMMANDS[self.command]

    @cached_property
    def state(self) -> EgoState:
        """Return the ego now, its rates by central differences: the start of the score."""
        now = self.frame
        return _moving(self._ego_track, self.vehicle, now=now, before=now - 1, after=now + 1)

    @cached_property
    def route(self) -> Route:
        """Return the route in the log's frame."""
        return Route(self.log.route(self.index))

    def before(self, seconds: float) -> Window:
        """Return the window as it was some time ago, with the route and command of now.

        Its ego knows what it does until now, as the record has it, and how fast it is then.
        """
        earlier, steps = Window(self._scenes, self.index), round(seconds / FRAME_S)
        earlier.frame -= steps
        times = np.asarray(FRAME_S * np.arange(steps + 2), np.float64)
        if steps:
            earlier.meanwhile = np.c_[times, earlier.recorded(times)]
        return earlier

    @cached_property
    def view(self) -> PlannerView:
        """Return what a planner sees; a log that begins within its past stands still before."""
        seen = np.arange(self.frame - HISTORY_FRAMES, self.frame + 1).clip(0)
        return planner_view(
            self.log.track_state[:, seen].astype(np.float64),
            ego=self.ego,
            track_type=self.log.track_type,
            track_size=self.log.track_size.astype(np.float64),
            route=self.log.route(self.index),
            command=self.command,
            speed_limit=self.speed_limit,
            scenes=self._scenes,
            frame=self.frame,
        )

    def recorded(self, times: Array) -> Array:
        """Poses [T, 3] of the ego in its frame now, at times (s); NaN beyond the record."""
        frames = self.frame + np.rint(np.asarray(times) / FRAME_S).astype(int)
        poses = np.full((len(frames), 3), np.nan)
        known = frames < len(self._ego_track)
        axle = ahead_of(self._ego_track[frames[known], :3], -self.vehicle.rear_axle)
        poses[known] = into_frame(axle, self.state.pose)
        poses[known, 2] = wrap_angle(poses[known, 2])
        return poses


def planner_view(
    tracks: Array,
    *,
    ego: int,
    track_type: NDArray[np.uint8],
    track_size: Array,
    route: Array,
    command: int,
    speed_limit: float,
    scenes: Scenes,
    frame: int = 0,
) -> PlannerView:
    """Make a view of the last frames of tracks [K, H + 1, 5], given in the log's frame.

    route: [V, 2] in the log's frame; scenes: whose map it is, and whose sensors at a frame
    """
    length, width = track_size[ego]
    vehicle = Vehicle(float(length), float(width))
    now = tracks.shape[1] - 1
    state = _moving(tracks[ego], vehicle, now=now, before=now - 1, after=now)
    return PlannerView(
        state=state,
        vehicle=vehicle,
        ego=ego,
        tracks=states_into_frame(tracks, state.pose),
        track_type=track_type,
        track_size=track_size,
        route=Route(into_frame(route, state.pose)),
        command=command,
        speed_limit=speed_limit,
        road=scenes.road,
        log_polylines=scenes.map_polylines,
        line_solid=scenes.log.line_solid,
        sensors=scenes.log.sensors,
        frame=frame,
    )


def _moving(track: Array, vehicle: Vehicle, *, now: int, before: int, after: int) -> EgoState:
    """How a track [F, 5] moves at a frame, its rates by differences between two others."""
    elapsed = (after - before) * FRAME_S
    heading, velocity = track[:, 2], track[:, 3:]
    direction = np.stack([np.cos(heading), np.sin(heading)], -1)
    along = (velocity * direction).sum(-1)
    speed = max(0.0, float(along[now]))
    turn = float(wrap_angle(heading[after] - heading[before])) / elapsed
    return EgoState(
        pose=ahead_of(track[now, :3], -vehicle.rear_axle),
        speed=speed,
        acceleration=float(along[after] - along[before]) / elapsed,
        curvature=turn / speed if speed > _SLOWEST_TURN else 0.0,
    )
