"""A SUMO net as lanes, what follows them, and the shapes between."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from anchorflow_driving.contours import union_rings
from anchorflow_driving.geometry import Array, arc_lengths, at_places

DEFAULT_WIDTH = 3.2
"""m, of lanes of which SUMO says nothing."""

CORNER = 1.2
"""m that the road is wider than its lanes in junctions."""


@dataclass(frozen=True, eq=False)
class NetLane:
    """A lane that cars drive on."""

    name: str
    edge: str
    index: int  # from the right
    centre: Array  # [V, 2]
    sumo_length: float  # m; SUMO's own, which its positions count by
    width: float
    speed: float  # m/s
    in_junction: bool

    @cached_property
    def arc_length(self) -> Array:
        return arc_lengths(self.centre)

    @property
    def polygon(self) -> Array:
        return band(self.centre, self.width)

    def points(self, positions: Array) -> Array:
        """[F, 2] of the centreline at positions [F] as SUMO counts them."""
        at = positions / self.sumo_length * self.arc_length[-1]
        return at_places(at, self.arc_length, self.centre)


@dataclass(frozen=True)
class Turn:
    """A connection to the next edge."""

    edge: str
    direction: str  # SUMO's: s, r, l, R, L or t


class RoadNet:
    """The lanes of a .net.xml and their surroundings.

    lanes: those of cars, by name
    following: the lanes after a lane
    turns: the edges after an edge
    """

    def __init__(self, path: Path) -> None:
        root = ElementTree.parse(path).getroot()
        self.lanes: dict[str, NetLane] = {}
        self.sidewalk_edges: list[str] = []
        self.crossings: list[Array] = []
        self.parking: list[Array] = []
        self.pavements: list[Array] = []
        self._walks: list[Array] = []
        for edge in root.iter("edge"):
            self._read_edge(edge)
        self._junctions = [
            shape(junction.attrib["shape"])
            for junction in root.iter("junction")
            if junction.attrib.get("type") != "internal" and "shape" in junction.attrib
        ]
        self._junctions = [polygon for polygon in self._junctions if len(polygon) > 2]
        self.following: dict[str, list[str]] = {name: [] for name in self.lanes}
        self.turns: dict[str, dict[str, Turn]] = {}
        for connection in root.iter("connection"):
            self._read_connection(connection.attrib)

    @cached_property
    def edges(self) -> dict[str, list[NetLane]]:
        """Lanes of the edges between junctions, from the right."""
        by_edge: dict[str, list[NetLane]] = {}
        for lane in self.lanes.values():
            if not lane.in_junction:
                by_edge.setdefault(lane.edge, []).append(lane)
        return by_edge

    def drivable_rings(self, *, level: float, also: Sequence[Array] = ()) -> list[Array]:
        """Around lanes, parking, junctions and `also`, without where else people walk."""
        # Lanes once more, since sidewalks may be cut out of their junctions' corners; wider in
        # junctions, where cars cut corners.
        lanes = [
            band(lane.centre, lane.width + (CORNER if lane.in_junction else 0.0))
            for lane in self.lanes.values()
        ]
        return union_rings(
            [*lanes, *self.parking, *self._junctions, *also],
            self._walks,
            again=[*lanes, *also],
            level=level,
        )

    def lines(self) -> Iterator[tuple[Array, bool]]:
        """Painted lines, and whether they are solid."""
        for lanes in self.edges.values():
            for lane in lanes:
                yield offset(lane.centre, lane.width / 2), lane is lanes[-1]
            yield offset(lanes[0].centre, -lanes[0].width / 2), True

    def _read_edge(self, edge: ElementTree.Element) -> None:
        function, name = edge.attrib.get("function", ""), edge.attrib["id"]
        for lane in edge.iter("lane"):
            data = lane.attrib
            centre = shape(data["shape"])
            width = float(data.get("width", DEFAULT_WIDTH))
            if function == "crossing":
                self.crossings.append(band(centre, width))
            elif function == "walkingarea":
                self._walks.append(centre)
            elif data.get("disallow") == "all":
                self.parking.append(band(centre, width))
            elif data.get("allow") == "pedestrian":
                self.pavements.append(band(centre, width))
                self._walks.append(self.pavements[-1])
                self.sidewalk_edges.append(name)
            elif function in ("", "internal"):
                self.lanes[data["id"]] = NetLane(
                    name=data["id"],
                    edge=name,
                    index=int(data["index"]),
                    centre=centre,
                    sumo_length=float(data["length"]),
                    width=width,
                    speed=float(data["speed"]),
                    in_junction=function == "internal",
                )

    def _read_connection(self, data: dict[str, str]) -> None:
        here, there = f"{data['from']}_{data['fromLane']}", f"{data['to']}_{data['toLane']}"
        if here not in self.lanes or there not in self.lanes:
            return
        via = data.get("via")
        self.following[here].append(via if via in self.lanes else there)
        if not self.lanes[here].in_junction:
            turns = self.turns.setdefault(data["from"], {})
            turns.setdefault(data["to"], Turn(data["to"], data["dir"]))


def shape(text: str) -> Array:
    """[V, 2] of SUMO's "x,y x,y"; heights are left out."""
    return np.array([[float(part) for part in point.split(",")[:2]] for point in text.split()])


def offset(line: Array, left: float) -> Array:
    """A polyline [V, 2] moved to its left, m; its corners are mitred."""
    steps = np.diff(line, axis=0)
    length = np.linalg.norm(steps, axis=1)
    line, steps = line[np.append(True, length > 1e-3)], steps[length > 1e-3]
    if not len(steps):
        return line
    normal = np.stack([-steps[:, 1], steps[:, 0]], -1) / np.linalg.norm(steps, axis=1)[:, None]
    before, after = np.concatenate([normal[:1], normal]), np.concatenate([normal, normal[-1:]])
    between = before + after
    # |between|² / 2 is the cosine's complement that stretches a mitre; hairpins are cut.
    return line + left * between / np.maximum((between**2).sum(1, keepdims=True) / 2, 0.5)


def band(line: Array, width: float) -> Array:
    """The polygon [2 V, 2] within half a width of a polyline."""
    return np.concatenate([offset(line, -width / 2), offset(line, width / 2)[::-1]])
