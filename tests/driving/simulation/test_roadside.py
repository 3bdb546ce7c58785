"""Objects beyond the kerb of a straight street, and between its directions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from anchorflow_driving.geometry import box_corners
from anchorflow_driving.log import PEDESTRIAN, STATIC, VEHICLE
from anchorflow_driving.road import DrivableGrid
from anchorflow_driving.simulation.road_net import RoadNet
from anchorflow_driving.simulation.roadside import Roadside, roadside

LEVEL = 0.2
STREET = """<net>
  <edge id="a" from="0" to="1">
    <lane id="a_0" index="0" speed="10" length="400" shape="0,-1.6 400,-1.6" width="3.2"/>
  </edge>
  <edge id="b" from="1" to="0">
    <lane id="b_0" index="0" speed="10" length="400" shape="400,1.6 0,1.6" width="3.2"/>
  </edge>
</net>"""


@pytest.fixture
def net(tmp_path: Path) -> RoadNet:
    path = tmp_path / "street.net.xml"
    path.write_text(STREET)
    return RoadNet(path)


def drawn(net: RoadNet, seeds: int = 12) -> list[Roadside]:
    return [roadside(net, np.random.default_rng(seed), level=LEVEL) for seed in range(seeds)]


def test_nothing_stands_on_the_road(net: RoadNet) -> None:
    road = DrivableGrid(tuple(net.drivable_rings(level=LEVEL)))
    standing = [each for beside in drawn(net) for each in beside.standing]
    assert {each.kind for each in standing} == {VEHICLE, PEDESTRIAN, STATIC}
    for each in standing:
        assert not road.holds(box_corners(each.state[:3], np.array(each.size))).any()
        assert 3.2 < abs(each.state[1]) < 40.0


def test_yards_belong_to_the_road(net: RoadNet) -> None:
    areas = [area for beside in drawn(net) for area in beside.areas]
    assert areas
    wide = DrivableGrid(tuple(net.drivable_rings(level=LEVEL, also=areas)))
    road = DrivableGrid(tuple(net.drivable_rings(level=LEVEL)))
    for area in areas:
        middle, farthest = area.mean(0), np.abs(area[:, 1]).max()
        across = np.linspace(3.8, farthest - 0.2, 20) * np.sign(middle[1])
        line = np.stack([np.full(20, middle[0]), across], -1)
        assert wide.holds(line).all()
        assert not road.holds(line).all()


def test_a_seed_decides_it(net: RoadNet) -> None:
    one, again = (roadside(net, np.random.default_rng(7), level=LEVEL) for _ in range(2))
    for left, right in zip(one.standing, again.standing, strict=True):
        np.testing.assert_array_equal(left.state, right.state)


def test_medians_part_the_directions(tmp_path: Path) -> None:
    for module in ("sumo", "libsumo"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    apart = {medians: _apart(tmp_path, medians=medians) for medians in (True, False)}
    assert max(apart[False]) < 0.3
    assert max(apart[True]) > 1.0
    assert min(apart[True]) < 0.3


def _apart(folder: Path, *, medians: bool) -> list[float]:
    """m between the two directions of the streets of some nets."""
    from anchorflow_driving.simulation.street_plan import make_net

    found = []
    for seed in range(2):
        net = RoadNet(make_net(np.random.default_rng(seed), folder, medians=medians))
        for name, lanes in net.edges.items():
            if not name.endswith("a") or f"{name[:-1]}b" not in net.edges:
                continue
            here, there = lanes[-1], net.edges[f"{name[:-1]}b"][-1]
            middle = here.centre[len(here.centre) // 2]
            steps = np.linspace(0, 1, 400)[:, None]
            line = np.concatenate(
                [a + steps * (b - a) for a, b in zip(there.centre, there.centre[1:], strict=False)]
            )
            gap = np.linalg.norm(line - middle, axis=1).min()
            found.append(float(gap) - (here.width + there.width) / 2)
    return found


def test_arterial_streets_are_longer_and_faster(tmp_path: Path) -> None:
    for module in ("sumo", "libsumo"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    from anchorflow_driving.simulation.road_net import RoadNet
    from anchorflow_driving.simulation.street_plan import (
        ARTERIAL,
        QUARTER,
        StreetKind,
        make_net,
    )

    def means(kind: StreetKind, folder: Path) -> tuple[float, float]:
        """Length [m] of the lanes between junctions, and their speed [m/s]."""
        lanes = []
        for seed in range(3):
            place = folder / str(seed)
            place.mkdir(parents=True)
            net = RoadNet(make_net(np.random.default_rng(seed), place, kind=kind))
            lanes += [lane for lane in net.lanes.values() if not lane.in_junction]
        lengths, speeds = zip(*[(lane.sumo_length, lane.speed) for lane in lanes], strict=True)
        return float(np.mean(lengths)), float(np.mean(speeds))

    (length, speed), (longer, faster) = (
        means(kind, tmp_path / name)
        for kind, name in ((QUARTER, "quarter"), (ARTERIAL, "arterial"))
    )

    assert longer > 1.5 * length
    assert faster > 1.2 * speed
