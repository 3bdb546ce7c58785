"""A run of SUMO, recorded at 10 Hz as SUMO tells it: front bumpers on lanes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import libsumo
import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.log import FRAME_S
from anchorflow_driving.simulation.demand import Demand
from anchorflow_driving.simulation.sumo_programs import SimulationError

PERSON_SIZE = (0.6, 0.6)
"""m"""
LATERAL_RESOLUTION = 0.3
"""m; without it SUMO's vehicles jump from lane to lane."""


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
    size: tuple[float, float]
    place: list[tuple[float, float]] = field(default_factory=list)


@dataclass(frozen=True)
class Recording:
    frames: int
    vehicles: list[VehicleRecord]
    people: list[PersonRecord]


class Traffic:
    """A running simulation; libsumo has one a process.

    Raises:
        SimulationError: SUMO does not start.
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

    def __enter__(self) -> Traffic:
        return self

    def __exit__(self, *_: object) -> None:
        libsumo.close()

    def step(self) -> None:
        libsumo.simulationStep()


def record(net: Path, demand: Demand, *, seed: int, frames: int) -> Recording:
    """Runs the traffic from its start for so many frames."""
    vehicles: dict[str, VehicleRecord] = {}
    people: dict[str, PersonRecord] = {}
    with Traffic(net, demand, seed=seed) as traffic:
        for frame in range(frames):
            traffic.step()
            _note_vehicles(vehicles, demand, frame)
            _note_people(people, frame)
    return Recording(frames, list(vehicles.values()), list(people.values()))


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
            known[name] = PersonRecord(frame, PERSON_SIZE)
        known[name].place.append(person.getPosition(name))


def as_array(points: list[tuple[float, float]]) -> NDArray[np.float64]:
    return np.array(points, np.float64).reshape(-1, 2)
