"""The map expansion of nuScenes, version 1.2 or later."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from anchorflow_driving.contours import keyholed, union_rings
from anchorflow_driving.geometry import Array
from anchorflow_driving.importers.fields import Entry, by_token
from anchorflow_driving.importers.recording import is_near
from anchorflow_driving.log import Lane, RoadMap

STEP = 1.0
"""m between the points of a centreline."""
CONNECTOR_WIDTH = 3.5
"""m, of connectors that have no polygon."""
TURNS = {"L": 1.0, "S": 0.0, "R": -1.0}


def read_map(path: Path, box: tuple[Array, Array], counts: Counter[str]) -> RoadMap:
    """Read the map near a box (its low and high corner).

    A connector belongs to a junction. The drivable area is the union of its layer's polygons.

    Raises `LogError`.
    """
    return _Expansion(path, box).road(counts)


def arc_points(path: Entry) -> Array:
    """[V, 2] along an `arcline_path_3`: three arcs or lines from its start pose."""
    x, y, heading = path["start_pose"].numbers(3)
    shape, radius = path["shape"], path["radius"].number
    if len(shape.text) != 3 or set(shape.text) - set(TURNS):
        raise shape.refuse("three of L, S and R", repr(shape.text))
    if radius <= 0:
        raise path.refuse("a radius above 0", radius, within="radius")
    points = [np.array([[x, y]])]
    for turn, length in zip(shape.text, path["segment_length"].numbers(3), strict=True):
        along = np.linspace(0.0, length, max(1, int(np.ceil(length / STEP))) + 1)[1:]
        bend = TURNS[turn] / radius * along
        # The chord of an arc: its length, and half its turn from where it began.
        chord = along * np.sinc(bend / 2 / np.pi)
        towards = heading + bend / 2
        part = np.stack([x + chord * np.cos(towards), y + chord * np.sin(towards)], -1)
        (x, y), heading = part[-1], heading + bend[-1]
        points.append(part)
    return np.concatenate(points)


class _Expansion:
    def __init__(self, path: Path, box: tuple[Array, Array]) -> None:
        self._root = Entry.of_json(path)
        self._box = box
        self._nodes = by_token(self._root["node"])
        self._polygons = by_token(self._root["polygon"])
        self._lines = by_token(self._root["line"])

    def road(self, counts: Counter[str]) -> RoadMap:
        lanes = list(self._lanes(counts))
        if not lanes:
            raise self._root.refuse("lanes near the recorded tracks", "none", within="lane")
        crossings = [self._exterior(row["polygon_token"]) for row in self._root["ped_crossing"]]
        return RoadMap(
            lanes=lanes,
            drivable=union_rings(list(self._drivable()), level=0.5, within=self._box),
            crosswalks=[ring for ring in crossings if is_near(ring, self._box)],
            lines=[line for line in self._painted() if is_near(line[0], self._box)],
        )

    def _lanes(self, counts: Counter[str]) -> Iterator[Lane]:
        paths, connectivity = self._root["arcline_path_3"], self._root["connectivity"]
        for layer in ("lane", "lane_connector"):
            for row in self._root[layer]:
                token = row["token"].text
                arcs = paths.maybe(token)
                if arcs is None:
                    counts["dropped: lane without an arcline_path_3"] += 1
                    continue
                centre = _joined([arc_points(arc) for arc in arcs])
                if len(centre) < 2 or not is_near(centre, self._box):
                    continue
                outline = row.maybe("polygon_token")
                yield Lane(
                    name=token,
                    polygon=_strip(centre) if outline is None else self._exterior(outline),
                    centre=centre,
                    successors=connectivity[token]["outgoing"].texts,
                    in_junction=layer == "lane_connector",
                )

    def _drivable(self) -> Iterator[Array]:
        for area in self._root["drivable_area"]:
            for token in area["polygon_tokens"]:
                exterior = self._exterior(token)
                if is_near(exterior, self._box):
                    holes = self._find(self._polygons, token, "polygon")["holes"]
                    inner = [self._points(hole["node_tokens"]) for hole in holes]
                    yield keyholed(exterior, inner)

    def _painted(self) -> Iterator[tuple[Array, bool]]:
        for divider in self._root["road_divider"]:
            line = self._find(self._lines, divider["line_token"], "line")
            yield self._points(line["node_tokens"]), True
        for divider in self._root["lane_divider"]:
            segments = list(divider["lane_divider_segments"])
            kinds = [segment["segment_type"].text for segment in segments]
            points = [self._node(segment["node_token"]) for segment in segments]
            begin = 0
            for end in range(1, len(points)):  # a segment's type holds up to the next node
                if end == len(points) - 1 or kinds[end] != kinds[begin]:
                    if kinds[begin] != "NIL":
                        solid = "SOLID" in kinds[begin]
                        yield np.stack(points[begin : end + 1]), solid
                    begin = end

    def _exterior(self, token: Entry) -> Array:
        polygon = self._find(self._polygons, token, "polygon")
        ring = self._points(polygon["exterior_node_tokens"])
        if len(ring) < 3:
            raise polygon.refuse("three nodes or more", len(ring), within="exterior_node_tokens")
        return ring

    def _points(self, tokens: Entry) -> Array:
        points = [self._node(token) for token in tokens]
        if len(points) < 2:
            raise tokens.refuse("two nodes or more", len(points))
        return np.stack(points)

    def _node(self, token: Entry) -> Array:
        node = self._find(self._nodes, token, "node")
        return np.array([node["x"].number, node["y"].number])

    def _find(self, layer: dict[str, Entry], token: Entry, name: str) -> Entry:
        if token.text not in layer:
            raise token.refuse(f"a token of the layer {name}", repr(token.text))
        return layer[token.text]


def _joined(parts: Sequence[Array]) -> Array:
    """One line without the points that its parts have in common."""
    points = np.concatenate([*parts, np.zeros((0, 2))])
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-3
    return points[np.append(True, moved)[: len(points)]]


def _strip(centre: Array) -> Array:
    slope = np.gradient(centre, axis=0)
    left = np.stack([-slope[:, 1], slope[:, 0]], -1) / np.linalg.norm(slope, axis=1)[:, None]
    aside = left * CONNECTOR_WIDTH / 2
    return np.concatenate([centre - aside, (centre + aside)[::-1]])
