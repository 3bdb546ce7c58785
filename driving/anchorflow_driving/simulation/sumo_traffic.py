"""SUMO's traffic at 10 Hz: recorded runs, and live runs in which the ego is driven by a planner."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import libsumo
import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.errors import SimulationError
from anchorflow_driving.geometry import Array, ahead_of
from anchorflow_driving.log import FRAME_S, HISTORY_FRAMES, PEDESTRIAN
from anchorflow_driving.simulation.demand import Demand
from anchorflow_driving.simulation.roadside import Standing

PERSON_SIZE = (0.6, 0.6)
"""m"""
LATERAL_RESOLUTION = 0.3
"""m; without it SUMO's vehicles jump from lane to lane."""

FREE_PLACEMENT = 2
"""moveToXY's keepRoute: exactly there, on the route or off it."""
UNCHECKED = 0
"""Speed and lane-change modes in which SUMO leaves a vehicle to us."""


@dataclass
class VehicleRecord:
    """What SUMO said of a vehicle, from `first` on at every frame."""

    first: int
    kind: int
    size: tuple[float, float]  # length, width
    route: list[str]  # edges
    on_route: int = 0  # index of the edge where it was last
    front: list[tuple[float, float]] = field(default_factory=list)
    lane: list[tuple[str, float]] = field(default_factory=list)  # and the position along it, m


@dataclass
class PersonRecord:
    """What SUMO said of a person."""

    first: int
    place: list[tuple[float, float]] = field(default_factory=list)


@dataclass(frozen=True)
class Recording:
    vehicles: list[VehicleRecord]
    people: list[PersonRecord]


Run = TypeVar("Run", bound="SumoRun")


class SumoRun:
    """A running simulation; libsumo has one a process.

    Raises `SimulationError` if SUMO does not start.
    """

    def __init__(self, net: Path, demand: Demand, *, seed: int) -> None:
        options = {
            "net-file": str(net),
            "route-files": str(demand.file),
            "step-length": str(FRAME_S),
            "lateral-resolution": str(LATERAL_RESOLUTION),
            "seed": str(seed),
            "time-to-teleport": "-1",
            "collision.action": "warn",
            "no-warnings": "true",
            "no-step-log": "true",
            "xml-validation": "never",
            "default.speeddev": "0.05",
            # A person whose sidewalks do not join stays at home.
            "ignore-route-errors": "true",
        }
        try:
            libsumo.start(["sumo", *(part for k, v in options.items() for part in (f"--{k}", v))])
        except libsumo.TraCIException as error:
            raise SimulationError(f"sumo: {error}") from error

    def __enter__(self: Run) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        libsumo.close()

    def step(self) -> None:
        libsumo.simulationStep()


def record(net: Path, demand: Demand, *, seed: int, frames: int) -> Recording:
    """Run the traffic from its start for `frames` frames."""
    vehicles: dict[str, VehicleRecord] = {}
    people: dict[str, PersonRecord] = {}
    with SumoRun(net, demand, seed=seed) as traffic:
        for frame in range(frames):
            traffic.step()
            _note_vehicles(vehicles, demand, frame)
            _note_people(people, frame)
    return Recording(list(vehicles.values()), list(people.values()))


def _note_vehicles(known: dict[str, VehicleRecord], demand: Demand, frame: int) -> None:
    vehicle = libsumo.vehicle
    for name in vehicle.getIDList():
        if name not in known:
            known[name] = VehicleRecord(
                first=frame,
                kind=demand.vehicle_kind[vehicle.getTypeID(name).partition("@")[0]],
                size=(vehicle.getLength(name), vehicle.getWidth(name)),
                route=demand.routes[name],
            )
        known[name].on_route = vehicle.getRouteIndex(name)
        known[name].front.append(vehicle.getPosition(name))
        known[name].lane.append((vehicle.getLaneID(name), vehicle.getLanePosition(name)))


def _note_people(known: dict[str, PersonRecord], frame: int) -> None:
    person = libsumo.person
    for name in person.getIDList():
        if name not in known:
            known[name] = PersonRecord(frame)
        known[name].place.append(person.getPosition(name))


def as_array(points: list[tuple[float, float]]) -> NDArray[np.float64]:
    return np.array(points, np.float64).reshape(-1, 2)


@dataclass(frozen=True)
class Seen:
    """All K tracks in F frames."""

    names: list[str]  # of standing objects as well
    states: Array  # [K, F, 5], NaN where absent; the last frame is now
    size: Array  # [K, 2]
    kind: NDArray[np.uint8]  # [K]


class LiveTraffic(SumoRun):
    """A run that moves the ego and keeps the last frames.

    standing: objects beside the road
    """

    def __init__(self, net: Path, demand: Demand, *, seed: int, standing: list[Standing]) -> None:
        super().__init__(net, demand, seed=seed)
        self._demand, self._standing = demand, standing
        self._past: deque[dict[str, Array]] = deque(maxlen=HISTORY_FRAMES + 1)
        self._size: dict[str, tuple[float, float]] = {}
        self._kind: dict[str, int] = {}

    @property
    def vehicles(self) -> list[str]:
        return sorted(name for name in self._past[-1] if self._kind[name] != PEDESTRIAN)

    @property
    def past(self) -> list[dict[str, Array]]:
        """Who was where in the last frames, [5] each; the last one is now."""
        return list(self._past)

    def size_of(self, name: str) -> tuple[float, float]:
        return self._size[name]

    def state_of(self, name: str) -> Array:
        """[5] now."""
        return self._past[-1][name]

    def kind_of(self, name: str) -> int:
        return self._kind[name]

    def lane_of(self, name: str) -> tuple[str, float]:
        """The lane and the position along it, m."""
        return libsumo.vehicle.getLaneID(name), libsumo.vehicle.getLanePosition(name)

    def route_ahead(self, name: str) -> list[str]:
        """The edges that are left, the present one first."""
        return self._demand.routes[name][libsumo.vehicle.getRouteIndex(name) :]

    def take_over(self, name: str) -> None:
        libsumo.vehicle.setSpeedMode(name, UNCHECKED)
        libsumo.vehicle.setLaneChangeMode(name, UNCHECKED)

    def step(self, ego: str | None = None, pose: Array | None = None, speed: float = 0.0) -> None:
        """One frame; the middle of the ego's box moves to `pose` [3] at `speed`."""
        if ego is not None and pose is not None:
            front = ahead_of(pose, self._size[ego][0] / 2)
            bearing = 90.0 - np.rad2deg(pose[2])
            libsumo.vehicle.setSpeed(ego, speed)
            libsumo.vehicle.moveToXY(
                ego, "", -1, front[0], front[1], angle=bearing % 360.0, keepRoute=FREE_PLACEMENT
            )
        super().step()
        now = {**self._vehicles(), **self._people()}
        if ego is not None and pose is not None:
            velocity = speed * np.array([np.cos(pose[2]), np.sin(pose[2])])
            now[ego] = np.concatenate([pose, velocity])
        self._past.append(now)

    def seen(self, frames: Sequence[dict[str, Array]] | None = None) -> Seen:
        """Everybody in these frames, all of which passed here; in the last ones, unless told."""
        frames = self._past if frames is None else frames
        names = sorted({name for frame in frames for name in frame})
        absent = np.full(5, np.nan)
        moving = [[frame.get(name, absent) for frame in frames] for name in names]
        standing = [[each.state] * len(frames) for each in self._standing]
        size = [self._size[name] for name in names] + [each.size for each in self._standing]
        kind = [self._kind[name] for name in names] + [each.kind for each in self._standing]
        states = np.array(moving + standing)
        # Headings unwrapped, as a log has them.
        turn = np.nan_to_num(states[..., 2])
        states[..., 2] += np.unwrap(turn, axis=1) - turn
        names += [f"standing {index}" for index in range(len(standing))]
        return Seen(names, states, np.array(size), np.array(kind, np.uint8))

    def _vehicles(self) -> dict[str, Array]:
        states, vehicle = {}, libsumo.vehicle
        for name in vehicle.getIDList():
            if name not in self._size:
                kind = vehicle.getTypeID(name).partition("@")[0]
                self._size[name] = vehicle.getLength(name), vehicle.getWidth(name)
                self._kind[name] = self._demand.vehicle_kind[kind]
            pose = np.array([*vehicle.getPosition(name), np.deg2rad(90.0 - vehicle.getAngle(name))])
            states[name] = _state(ahead_of(pose, -self._size[name][0] / 2), vehicle.getSpeed(name))
        return states

    def _people(self) -> dict[str, Array]:
        states, person = {}, libsumo.person
        for name in person.getIDList():
            self._size[name], self._kind[name] = PERSON_SIZE, PEDESTRIAN
            pose = np.array([*person.getPosition(name), np.deg2rad(90.0 - person.getAngle(name))])
            states[name] = _state(pose, person.getSpeed(name))
        return states


def _state(pose: Array, speed: float) -> Array:
    return np.array([*pose, speed * np.cos(pose[2]), speed * np.sin(pose[2])])
