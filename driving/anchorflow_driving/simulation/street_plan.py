"""Street plans: what netgenerate draws, bent, turned, given roundabouts, lanes and lights.

netgenerate's streets are straight and alike; real ones are not, and a planner shall not learn that
they are.
"""

from __future__ import annotations

import math
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import sumo

from anchorflow_driving.errors import SimulationError
from anchorflow_driving.geometry import Array
from anchorflow_driving.simulation.road_net import offset

POINT_SPACING = 4.0
"""m between the points of a bent street."""
PARKING_WIDTH = "2.70"
"""m"""
LEAST_ROUNDABOUT_ANGLE = np.deg2rad(50.0)
"""Between two of its streets."""
HOME = Path(sumo.SUMO_HOME)


@dataclass
class Street:
    """Between two nodes; one line for both directions."""

    start: str
    end: str
    line: Array  # [V, 2] from start to end
    lanes: int  # a direction
    speed: float  # m/s
    lane_width: float  # m
    parking: bool
    one_way: bool = False
    median: float = 0.0  # m between the directions


@dataclass
class StreetPlan:
    """Nodes by name, and the streets between them."""

    nodes: dict[str, Array]  # [2]
    kinds: dict[str, str]  # SUMO's node types
    streets: list[Street]

    def degree(self, node: str) -> int:
        return sum(node in (street.start, street.end) for street in self.streets)


@dataclass(frozen=True)
class StreetKind:
    """How long, how many and how fast the streets of a net are.

    length, crossings: times those of a quarter
    speeds: m/s, of which a net has one, and so much of it on its slower streets
    widest: most that the chance of a further lane can be
    """

    length: float
    crossings: float
    speeds: tuple[float, ...]
    slower: float
    widest: float


QUARTER = StreetKind(1.0, 1.0, (8.3, 11.1, 13.9, 16.7), slower=0.75, widest=0.7)
ARTERIAL = StreetKind(2.2, 0.5, (13.9, 15.3, 16.7), slower=0.85, widest=0.9)


def make_net(
    rng: np.random.Generator,
    folder: Path,
    *,
    lights: bool = True,
    medians: bool = False,
    kind: StreetKind = QUARTER,
) -> Path:
    """Draws a street plan and has netconvert build its net; the path of the .net.xml."""
    plan = _skeleton(rng, folder, kind)
    if medians:
        _part(plan, rng)
    _bend(plan, rng)
    _add_roundabouts(plan, rng)
    _regulate(plan, rng, lights=lights)
    _write(plan, folder)
    net = folder / "street.net.xml"
    sidewalks = rng.random() < 0.65
    walking = ("--sidewalks.guess", "--crossings.guess", "--sidewalks.guess.max-speed", "20")
    run_program(
        "netconvert",
        *("--node-files", str(folder / "street.nod.xml")),
        *("--edge-files", str(folder / "street.edg.xml")),
        *("--output-file", str(net)),
        *("--no-turnarounds", "true"),
        *("--junctions.internal-link-detail", "20"),
        *("--junctions.corner-detail", "6"),
        *("--junctions.limit-turn-speed", f"{rng.uniform(1.0, 2.4):.2f}"),
        *("--default.junctions.radius", f"{rng.uniform(5.0, 10.0):.2f}"),
        *("--default.sidewalk-width", f"{rng.uniform(1.6, 3.0):.2f}"),
        *("--offset.disable-normalization", "true"),
        *(walking if sidewalks else ()),
    )
    return net


def _skeleton(rng: np.random.Generator, folder: Path, kind: StreetKind) -> StreetPlan:
    """Nodes and streets of netgenerate, shifted a little and turned as a whole."""
    run_program(
        "netgenerate",
        *_family(rng, kind),
        *("--seed", str(rng.integers(2**31))),
        *("--plain-output-prefix", str(folder / "skeleton")),
        *("--output-file", str(folder / "skeleton.net.xml")),
    )
    nodes = {
        node.attrib["id"]: np.array([float(node.attrib["x"]), float(node.attrib["y"])])
        for node in ElementTree.parse(folder / "skeleton.nod.xml").iter("node")
    }
    middle = np.mean(list(nodes.values()), axis=0)
    jitter, angle = rng.uniform(0.0, 8.0), rng.uniform(0.0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    nodes = {
        name: turn @ (place - middle + rng.uniform(-jitter, jitter, 2))
        for name, place in nodes.items()
    }
    pairs = dict.fromkeys(
        tuple(sorted((edge.attrib["from"], edge.attrib["to"])))
        for edge in ElementTree.parse(folder / "skeleton.edg.xml").iter("edge")
    )
    width, fast = rng.uniform(2.9, 3.7), rng.choice(kind.speeds)
    wide, parking = rng.uniform(0.0, kind.widest), rng.uniform(0.0, 0.5)
    streets = [
        Street(
            start=a,
            end=b,
            line=np.stack([nodes[a], nodes[b]]),
            lanes=1 + int(rng.binomial(2, wide)),
            speed=float(rng.choice([fast, fast * kind.slower])),
            lane_width=float(width + rng.uniform(-0.15, 0.15)),
            parking=bool(rng.random() < parking),
            one_way=bool(rng.random() < 0.06),
        )
        for a, b in pairs
    ]
    return StreetPlan(nodes, dict.fromkeys(nodes, "priority"), streets)


def _family(rng: np.random.Generator, kind: StreetKind) -> list[str]:
    """Arguments of netgenerate."""
    length, crossings = kind.length, kind.crossings
    family = rng.choice(["grid", "spider", "rand"], p=[0.4, 0.25, 0.35])
    if family == "grid":
        numbers = {
            "grid.x-number": int(rng.integers(2, 2 + math.ceil(3 * crossings))),
            "grid.y-number": int(rng.integers(2, 2 + math.ceil(2 * crossings))),
            "grid.x-length": length * rng.uniform(60.0, 130.0),
            "grid.y-length": length * rng.uniform(60.0, 130.0),
            "grid.attach-length": length * rng.uniform(50.0, 90.0),
        }
    elif family == "spider":
        numbers = {
            "spider.arm-number": int(rng.integers(4, 7)),
            "spider.circle-number": int(rng.integers(2, 2 + math.ceil(2 * crossings))),
            "spider.space-radius": length * rng.uniform(55.0, 90.0),
        }
    else:
        numbers = {
            "rand.iterations": int(rng.integers(int(9 * crossings), int(18 * crossings))),
            "rand.min-distance": length * rng.uniform(50.0, 80.0),
            "rand.max-distance": length * rng.uniform(100.0, 170.0),
            "rand.min-angle": 50,
        }
    options = [f"--{family}"]
    for name, value in numbers.items():
        options += [f"--{name}", str(value) if isinstance(value, int) else f"{value:.2f}"]
    return options


def _bend(plan: StreetPlan, rng: np.random.Generator) -> None:
    """Arcs and S-shapes across each street, up to an eighth of its length."""
    strength = rng.choice([0.0, 0.05, 0.125], p=[0.2, 0.4, 0.4])
    lateral = float(rng.uniform(1.2, 2.6))  # m/s²
    for street in plan.streets:
        start, end = street.line
        along = end - start
        length = float(np.linalg.norm(along))
        u = np.linspace(0.0, 1.0, max(2, round(length / POINT_SPACING)) + 1)[:, None]
        left = np.array([-along[1], along[0]])
        arc, s_shape = rng.uniform(-strength, strength, 2)
        across = arc * np.sin(np.pi * u) + s_shape / 2 * np.sin(2 * np.pi * u)
        street.line = start + u * along + across * left
        street.speed = min(street.speed, _speed_through(street.line, lateral))


def _speed_through(line: Array, lateral: float) -> float:
    """m/s at which the sharpest curvature of a line costs so much lateral acceleration."""
    if len(line) < 3:
        return np.inf
    step = np.diff(line, axis=0)
    turn = np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
    curvature = np.abs(turn).max() / np.linalg.norm(step, axis=1).mean()
    return float(np.sqrt(lateral / max(curvature, 1e-6)))


def _part(plan: StreetPlan, rng: np.random.Generator) -> None:
    """Puts medians between the directions of some streets."""
    share, width = rng.choice([0.0, 0.3, 0.8]), rng.uniform(1.2, 5.0)
    for street in plan.streets:
        if rng.random() < share and not street.one_way:
            street.median = float(width)


def _add_roundabouts(plan: StreetPlan, rng: np.random.Generator) -> None:
    """Replaces some crossings of three streets and more by rings."""
    share = rng.choice([0.0, 0.3, 0.7], p=[0.5, 0.3, 0.2])
    for node in list(plan.nodes):
        if plan.degree(node) >= 3 and rng.random() < share:
            radius = float(rng.uniform(10.0, 20.0))
            _add_roundabout(plan, node, radius=radius, lanes=1 + int(rng.random() < 0.15))


def _add_roundabout(plan: StreetPlan, node: str, *, radius: float, lanes: int) -> None:
    middle = plan.nodes[node]
    arms = [street for street in plan.streets if node in (street.start, street.end)]
    cut = {}
    for street in arms:
        outward = street.line if street.start == node else street.line[::-1]
        beyond = outward[np.linalg.norm(outward - middle, axis=1) > 1.2 * radius]
        if len(beyond) < 5:  # too short for both
            return
        direction = beyond[0] - middle
        angle = float(np.arctan2(direction[1], direction[0]))
        ring = middle + radius * np.array([np.cos(angle), np.sin(angle)])
        cut[angle] = (street, np.concatenate([ring[None], beyond]))
    angles = sorted(cut)
    gaps = np.diff([*angles, angles[0] + 2 * np.pi])
    if gaps.min() < LEAST_ROUNDABOUT_ANGLE:
        return
    names = [f"{node}.{index}" for index in range(len(angles))]
    for name, angle in zip(names, angles, strict=True):
        street, line = cut[angle]
        plan.nodes[name], plan.kinds[name] = line[0], "priority"
        if street.start == node:
            street.start, street.line = name, line
        else:
            street.end, street.line = name, line[::-1]
    for index, (angle, gap) in enumerate(zip(angles, gaps, strict=True)):
        # Counter-clockwise, as right-hand traffic goes round.
        sweep = angle + np.linspace(0.0, gap, max(3, round(radius * gap / 2.0)))
        line = middle + radius * np.stack([np.cos(sweep), np.sin(sweep)], -1)
        ends = names[index], names[(index + 1) % len(names)]
        speed, width = 7.0 + radius / 8, 4.2
        plan.streets.append(Street(*ends, line, lanes, speed, width, False, one_way=True))
    del plan.nodes[node], plan.kinds[node]


def _regulate(plan: StreetPlan, rng: np.random.Generator, *, lights: bool) -> None:
    """Traffic lights, stops, or priority to the right where enough streets meet."""
    share = rng.uniform(0.0, 0.8)
    other = rng.choice(["priority", "right_before_left", "allway_stop"], p=[0.7, 0.2, 0.1])
    for node in plan.nodes:
        if plan.degree(node) >= 3 and "." not in node:
            lit = rng.random() < share and lights
            plan.kinds[node] = "traffic_light" if lit else str(other)


def _write(plan: StreetPlan, folder: Path) -> None:
    """The two files that netconvert reads."""
    nodes = ElementTree.Element("nodes")
    for name, (x, y) in plan.nodes.items():
        place = {"id": name, "x": f"{x:.3f}", "y": f"{y:.3f}", "type": plan.kinds[name]}
        ElementTree.SubElement(nodes, "node", place)
    edges = ElementTree.Element("edges")
    for index, street in enumerate(plan.streets):
        ways = [("a", street.start, street.end, street.line)]
        if not street.one_way:
            ways.append(("b", street.end, street.start, street.line[::-1]))
        for way, start, end, line in ways:
            right = offset(line, -street.median / 2) if street.median else line
            _add_edge(edges, f"{index}{way}", street, start, end, right)
    ElementTree.ElementTree(nodes).write(folder / "street.nod.xml")
    ElementTree.ElementTree(edges).write(folder / "street.edg.xml")


def _add_edge(
    edges: ElementTree.Element, name: str, street: Street, start: str, end: str, line: Array
) -> None:
    one_way_street = street.one_way and "." not in start
    attributes = {
        "id": name,
        "from": start,
        "to": end,
        # A ring has priority over its arms, a wide street over a narrow one.
        "priority": str(10 if street.one_way and not one_way_street else street.lanes),
        "numLanes": str(street.lanes + street.parking),
        "speed": f"{street.speed:.2f}",
        "width": f"{street.lane_width:.2f}",
        "shape": " ".join(f"{x:.3f},{y:.3f}" for x, y in line),
        "spreadType": "center" if street.one_way else "right",
    }
    edge = ElementTree.SubElement(edges, "edge", attributes)
    if street.parking:
        ElementTree.SubElement(
            edge, "lane", {"index": "0", "disallow": "all", "width": PARKING_WIDTH}
        )


def run_program(name: str, *arguments: str) -> None:
    """Runs netgenerate or netconvert. Raises `SimulationError` if it failed."""
    done = subprocess.run(
        [str(HOME / "bin" / name), *arguments],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "SUMO_HOME": str(HOME)},
    )
    if done.returncode:
        raise SimulationError(f"{name}: {done.stderr.strip() or done.returncode}")
