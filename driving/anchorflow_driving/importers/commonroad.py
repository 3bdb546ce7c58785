"""CommonRoad scenarios (Althoff, Koschi and Manzinger, 2017), format 2020a."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anchorflow_driving.contours import union_rings
from anchorflow_driving.geometry import Array
from anchorflow_driving.importers.fields import Element, as_number
from anchorflow_driving.importers.recording import Track, recorded_log
from anchorflow_driving.log import CYCLIST, PEDESTRIAN, STATIC, VEHICLE, DrivingLog, Lane, RoadMap

VERSION = "2020a"
KINDS = {
    "car": VEHICLE,
    "truck": VEHICLE,
    "bus": VEHICLE,
    "taxi": VEHICLE,
    "priorityVehicle": VEHICLE,
    "parkedVehicle": VEHICLE,
    "train": VEHICLE,
    "unknown": VEHICLE,
    "pedestrian": PEDESTRIAN,
    "bicycle": CYCLIST,
    "motorcycle": CYCLIST,
    "constructionZone": STATIC,
    "roadBoundary": STATIC,
    "building": STATIC,
    "pillar": STATIC,
    "median_strip": STATIC,
}
NOT_DRIVEN = {"crosswalk", "sidewalk", "bicycleLane", "border"}
FAR = 1000.0
"""m from zero, beyond which a scenario gets an origin of its own (UTM coordinates)."""
LEVEL = 0.23
"""Level of `union_rings`: recorded wheels touch the bounds, 0.3 m beside them is road."""


@dataclass(frozen=True)
class _Lanelet:
    name: str
    left: Array
    right: Array
    kinds: set[str]
    successors: list[str]
    marked: list[tuple[Array, bool]]  # painted bounds, and whether they are solid

    @property
    def polygon(self) -> Array:
        return np.concatenate([self.right, self.left[::-1]])

    @property
    def centre(self) -> Array:
        return (self.left + self.right) / 2


def import_commonroad(path: Path) -> tuple[DrivingLog, Counter[str]]:
    """The log of a scenario, with every window whose recorded future is good, and what was counted.

    States are interpolated to 10 Hz. Obstacles without a trajectory (occupancy sets) are left out.
    The frame is the scenario's, unless the first obstacle begins more than FAR from its zero: then
    that position becomes (0, 0). Raises `LogError`.
    """
    root = Element.of_file(path, "commonRoad")
    if (version := root.attribute("commonRoadVersion")) != VERSION:
        raise root.refuse(VERSION, version, within="commonRoadVersion")
    step = as_number(root.attribute("timeStepSize"), root)
    lanelets = [_lanelet(element) for element in root.children("lanelet")]
    driven = [lanelet for lanelet in lanelets if not lanelet.kinds & NOT_DRIVEN]
    if not driven:
        raise root.refuse("lanelets that vehicles drive on", "none", within="lanelet")
    counts: Counter[str] = Counter()
    tracks = [
        _track(element, [element.child("initialState")], np.zeros(1), stands=True)
        for element in root.children("staticObstacle")
    ]
    for element in root.children("dynamicObstacle"):
        if element.maybe("trajectory") is None:
            counts["dropped: obstacle without a trajectory"] += 1
        else:
            tracks.append(_dynamic(element, step))
    if not any(len(track.time) > 1 for track in tracks):
        raise root.refuse("obstacles with a trajectory", "none", within="dynamicObstacle")
    junctions = {
        lane.attribute("ref")
        for intersection in root.children("intersection")
        for incoming in intersection.children("incoming")
        for way in ("successorsRight", "successorsStraight", "successorsLeft")
        for lane in incoming.children(way)
    }
    first = tracks[0].poses[0, :2]
    log, chosen = recorded_log(
        tracks,
        _road(lanelets, driven, junctions),
        name=root.attribute("benchmarkID"),
        source="commonroad",
        licence="the scenario's",
        path=path,
        origin=first if np.linalg.norm(first) > FAR else None,
    )
    return log, counts + chosen


def _lanelet(element: Element) -> _Lanelet:
    left, right = (_bound(element.child(side)) for side in ("leftBound", "rightBound"))
    if len(left) != len(right):
        raise element.refuse(f"as many points as the left bound ({len(left)})", len(right))
    marked = []
    for side, points in (("leftBound", left), ("rightBound", right)):
        marking = element.child(side).maybe("lineMarking")
        if marking is not None and marking.text not in ("no_marking", "unknown", ""):
            marked.append((points, "solid" in marking.text))
    return _Lanelet(
        name=element.attribute("id"),
        left=left,
        right=right,
        kinds={kind.text for kind in element.children("laneletType")} - {"unknown"},
        successors=[each.attribute("ref") for each in element.children("successor")],
        marked=marked,
    )


def _bound(element: Element) -> Array:
    points = [(point.number("x"), point.number("y")) for point in element.children("point")]
    if len(points) < 2:
        raise element.refuse("two points or more", len(points))
    return np.array(points)


def _kind(element: Element) -> int:
    name = element.child("type").text
    if name not in KINDS:
        raise element.refuse(f"one of {', '.join(KINDS)}", repr(name), within="type")
    return KINDS[name]


def _size(element: Element) -> tuple[float, float]:
    shape = element.child("shape")
    rectangle, circle = shape.maybe("rectangle"), shape.maybe("circle")
    if rectangle is not None:
        size = rectangle.number("length"), rectangle.number("width")
    elif circle is not None:
        size = 2 * circle.number("radius"), 2 * circle.number("radius")
    else:
        raise shape.refuse("a rectangle or a circle", "neither")
    if min(size) <= 0:
        raise shape.refuse("a length and a width above 0", size)
    return size


def _state(element: Element) -> tuple[float, float, float, float]:
    point = element.child("position").child("point")
    speed = 0.0 if element.maybe("velocity") is None else element.number("velocity")
    return point.number("x"), point.number("y"), element.number("orientation"), speed


def _dynamic(element: Element, step: float) -> Track:
    nodes = [element.child("initialState"), *element.child("trajectory").children("state")]
    time = np.array([node.number("time") * step for node in nodes])
    if (np.diff(time) <= 0).any() or time[0] < 0:
        raise element.refuse(
            "times that grow from 0", time.tolist(), within="trajectory.state.time"
        )
    return _track(element, nodes, time)


def _track(element: Element, nodes: list[Element], time: Array, *, stands: bool = False) -> Track:
    x, y, heading, speed = np.array([_state(node) for node in nodes]).T
    speed = 0 * speed if stands else speed
    poses = np.stack([x, y, heading], -1)
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    always = len(time) == 1
    return Track(_kind(element), _size(element), time, poses, velocity, always=always)


def _road(lanelets: list[_Lanelet], driven: list[_Lanelet], junctions: set[str]) -> RoadMap:
    return RoadMap(
        lanes=[
            Lane(each.name, each.polygon, each.centre, each.successors, each.name in junctions)
            for each in driven
        ],
        drivable=union_rings([lanelet.polygon for lanelet in driven], level=LEVEL),
        crosswalks=[each.polygon for each in lanelets if "crosswalk" in each.kinds],
        lines=[line for lanelet in lanelets for line in lanelet.marked],
    )
