"""Who drives and walks on a net, and where to: vehicle types, routes, people, as a .rou.xml."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from anchorflow_driving.log import CYCLIST, VEHICLE
from anchorflow_driving.simulation.road_net import RoadNet

ROUTE_M = 700.0
"""Length of each vehicle's route, unless the net is smaller."""
TURN_WEIGHT = 2.2
"""Weight of a turn against going straight ahead."""
TYPES = 14


@dataclass(frozen=True)
class Demand:
    """vehicle_kind: VEHICLE or CYCLIST by vehicle type; routes: edges by vehicle."""

    file: Path
    vehicle_kind: dict[str, int]
    routes: dict[str, list[str]]


def make_demand(
    net: RoadNet,
    rng: np.random.Generator,
    folder: Path,
    *,
    warm_up_s: float,
    seconds: float,
    densest: float = 28.0,
) -> Demand:
    """Draws who is on the net for `warm_up_s` and `seconds`.

    densest: vehicles a lane and kilometre, of the densest traffic that is drawn
    """
    root = ElementTree.Element("routes")
    kinds = _add_types(root, rng)
    lane_km = sum(lane.sumo_length for lane in net.lanes.values() if not lane.in_junction) / 1e3
    density = float(np.exp(rng.uniform(np.log(4.0), np.log(densest))))  # a lane and kilometre
    count = int(np.clip(density * lane_km, 12, 130))
    entering = int(count * 0.5)
    departs = [
        *np.sort(rng.uniform(0.0, 0.4 * warm_up_s, count)),
        *np.sort(rng.uniform(0.4 * warm_up_s, warm_up_s + seconds, entering)),
    ]
    routes: dict[str, list[str]] = {}
    types = list(kinds)
    entries = _entries(net)
    length = np.array([lanes[0].sumo_length * len(lanes) for lanes in net.edges.values()])
    anywhere = [*net.edges], length / length.sum()
    for index, depart in enumerate(departs):
        name, enters = f"v{index}", index >= count
        edges, share = (entries, None) if enters and entries else anywhere
        routes[name] = _walk(net, str(rng.choice(edges, p=share)), rng)
        attributes = {
            "id": name,
            "type": types[rng.integers(len(types))],
            "depart": f"{depart:.1f}",
            "departLane": "best",
            "departPos": "base" if enters else "random_free",
            "departSpeed": "desired" if enters else "max",
        }
        vehicle = ElementTree.SubElement(root, "vehicle", attributes)
        ElementTree.SubElement(vehicle, "route", {"edges": " ".join(routes[name])})
    _add_people(root, net, rng, warm_up_s=warm_up_s)
    # SUMO wants departures in order.
    root[:] = sorted(root, key=lambda entry: float(entry.attrib.get("depart", -1.0)))
    file = folder / "street.rou.xml"
    ElementTree.ElementTree(root).write(file)
    return Demand(file, kinds, routes)


def _add_types(root: ElementTree.Element, rng: np.random.Generator) -> dict[str, int]:
    kinds = {}
    hurry = rng.uniform(0.8, 1.15)
    for index in range(TYPES):
        body = rng.choice(
            ["passenger", "delivery", "truck", "motorcycle"], p=[0.8, 0.1, 0.05, 0.05]
        )
        length, width, height = {
            "passenger": (rng.uniform(3.7, 5.2), rng.uniform(1.7, 2.05), 1.6),
            "delivery": (rng.uniform(5.2, 6.8), rng.uniform(2.0, 2.3), 2.6),
            "truck": (rng.uniform(7.5, 11.0), rng.uniform(2.3, 2.55), 3.4),
            "motorcycle": (rng.uniform(1.9, 2.4), rng.uniform(0.7, 0.9), 1.5),
        }[str(body)]
        small = body == "motorcycle"
        model = str(rng.choice(["IDM", "EIDM", "Krauss"], p=[0.5, 0.3, 0.2]))
        attributes = {
            "id": f"t{index}",
            "vClass": "passenger",
            "length": f"{length:.2f}",
            "width": f"{width:.2f}",
            "height": f"{height:.2f}",
            "carFollowModel": model,
            "accel": f"{rng.uniform(1.2, 2.4):.2f}",
            "decel": f"{rng.uniform(2.0, 3.5):.2f}",
            "tau": f"{rng.uniform(1.0, 2.0):.2f}",
            "minGap": f"{rng.uniform(1.5, 3.0):.2f}",
            "minGapLat": f"{rng.uniform(0.6, 1.1):.2f}",
            "speedFactor": f"{hurry * rng.uniform(0.85, 1.1):.3f}",
            "maxSpeedLat": f"{rng.uniform(0.6, 1.2):.2f}",
            "latAlignment": str(rng.choice(["center", "arbitrary", "compact"], p=[0.7, 0.2, 0.1])),
            "lcMaxSpeedLatStanding": "0",
            "lcMaxSpeedLatFactor": f"{rng.uniform(0.08, 0.15):.3f}",
            "lcSpeedGain": f"{rng.uniform(0.5, 2.0):.2f}",
            "lcKeepRight": f"{rng.uniform(0.0, 1.0):.2f}",
            "lcAssertive": f"{rng.uniform(0.8, 1.5):.2f}",
            "jmTimegapMinor": f"{rng.uniform(1.0, 2.5):.2f}",
        }
        if model == "Krauss":
            attributes["sigma"] = f"{rng.uniform(0.0, 0.3):.2f}"
        ElementTree.SubElement(root, "vType", attributes)
        kinds[f"t{index}"] = CYCLIST if small else VEHICLE
    return kinds


def _add_people(
    root: ElementTree.Element, net: RoadNet, rng: np.random.Generator, *, warm_up_s: float
) -> None:
    sidewalks = net.sidewalk_edges
    if not sidewalks:
        return
    for index in range(int(rng.integers(5, 60))):
        here = sidewalks[rng.integers(len(sidewalks))]
        beyond = [turn for turn in net.turns.get(here, {}) if turn in sidewalks]
        there = beyond[rng.integers(len(beyond))] if beyond else here
        depart = f"{rng.uniform(0.0, warm_up_s):.1f}"
        person = ElementTree.SubElement(
            root, "person", {"id": f"p{index}", "depart": depart, "departPos": "random"}
        )
        ElementTree.SubElement(person, "walk", {"from": here, "to": there, "arrivalPos": "random"})


def _walk(net: RoadNet, start: str, rng: np.random.Generator) -> list[str]:
    """A random walk over the edges; what leads on is preferred to what leads out."""
    route, length = [start], net.edges[start][0].sumo_length
    while length < ROUTE_M and net.turns.get(route[-1]):
        turns = list(net.turns[route[-1]].values())
        weight = np.array([1.0 if turn.direction == "s" else TURN_WEIGHT for turn in turns])
        weight *= [1.0 if net.turns.get(turn.edge) else 0.3 for turn in turns]
        edge = turns[rng.choice(len(turns), p=weight / weight.sum())].edge
        route.append(edge)
        length += net.edges[edge][0].sumo_length
    return route


def _entries(net: RoadNet) -> list[str]:
    """Edges that nothing leads to."""
    reached = {edge for turns in net.turns.values() for edge in turns}
    return [edge for edge in net.edges if edge not in reached and net.turns.get(edge)]
