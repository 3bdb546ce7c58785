"""CommonRoad scenarios made here: a street, a bend to the left in a junction, a street."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from anchorflow_driving.drivers import human
from anchorflow_driving.errors import LogError
from anchorflow_driving.importers.commonroad import import_commonroad
from anchorflow_driving.log import COMMANDS, PEDESTRIAN, VEHICLE, read_log, write_log
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes

STEP, SPEED, RADIUS, STRAIGHT, WIDTH = 0.2, 8.0, 20.0, 80.0, 4.0
BEND = RADIUS * np.pi / 2


def place(s: float, left: float = 0.0) -> tuple[float, float, float]:
    """x, y, heading at an arc length of the street, so far to its left."""
    if s < STRAIGHT:
        x, y, heading = s, 0.0, 0.0
    elif s < STRAIGHT + BEND:
        heading = (s - STRAIGHT) / RADIUS
        x, y = STRAIGHT + RADIUS * np.sin(heading), RADIUS * (1 - np.cos(heading))
    else:
        x, y, heading = STRAIGHT + RADIUS, RADIUS + s - STRAIGHT - BEND, np.pi / 2
    return x - left * np.sin(heading), y + left * np.cos(heading), heading


def points(begin: float, end: float, left: float) -> str:
    at = (place(s, left) for s in np.linspace(begin, end, 25))
    return "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y, _ in at)


def lanelet(name: int, begin: float, end: float, after: str = "") -> str:
    sides = {"left": WIDTH / 2, "right": -WIDTH / 2}
    bounds = "".join(
        f"<{side}Bound>{points(begin, end, left)}<lineMarking>solid</lineMarking></{side}Bound>"
        for side, left in sides.items()
    )
    return f'<lanelet id="{name}">{bounds}{after}<laneletType>urban</laneletType></lanelet>'


def state(tag: str, step: int, s: float, speed: float) -> str:
    x, y, heading = place(s)
    return (
        f"<{tag}><position><point><x>{x}</x><y>{y}</y></point></position>"
        f"<orientation><exact>{heading}</exact></orientation><time><exact>{step}</exact></time>"
        f"<velocity><exact>{speed}</exact></velocity></{tag}>"
    )


def obstacle(name: int, kind: str, shape: str, states: str) -> str:
    return (
        f'<dynamicObstacle id="{name}"><type>{kind}</type><shape>{shape}</shape>'
        f"{states}</dynamicObstacle>"
    )


CAR = "<rectangle><length>4.5</length><width>1.8</width></rectangle>"


def scenario() -> str:
    driven = "".join(state("state", k, 5 + SPEED * STEP * k, SPEED) for k in range(1, 90))
    walked = "".join(state("state", k, 60.0, 0.0) for k in range(1, 40))
    car = state("initialState", 0, 5.0, SPEED) + f"<trajectory>{driven}</trajectory>"
    walker = state("initialState", 0, 60.0, 0.0) + f"<trajectory>{walked}</trajectory>"
    walker = walker.replace("<y>0.0</y>", "<y>5.0</y>")
    return (
        '<commonRoad commonRoadVersion="2020a" benchmarkID="MADE_Up-1_1_T-1"'
        f' timeStepSize="{STEP}">'
        + lanelet(1, 0, STRAIGHT, '<successor ref="2"/>')
        + lanelet(2, STRAIGHT, STRAIGHT + BEND, '<predecessor ref="1"/><successor ref="3"/>')
        + lanelet(3, STRAIGHT + BEND, 220.0)
        + obstacle(10, "car", CAR, car)
        + obstacle(11, "pedestrian", "<circle><radius>0.3</radius></circle>", walker)
        + '<intersection id="20"><incoming id="21"><incomingLanelet ref="1"/>'
        '<successorsLeft ref="2"/></incoming></intersection></commonRoad>'
    )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "made.xml"
    path.write_text(scenario())
    return path


def test_a_scenario_becomes_a_log(file: Path, tmp_path: Path) -> None:
    log, counts = import_commonroad(file)

    assert (log.name, log.source) == ("MADE_Up-1_1_T-1", "commonroad")
    assert log.track_type.tolist() == [VEHICLE, PEDESTRIAN]
    np.testing.assert_allclose(log.track_size, [[4.5, 1.8], [0.6, 0.6]], rtol=1e-6)
    assert log.track_state.shape == (2, 179, 5)  # 89 steps of 0.2 s at 10 Hz
    np.testing.assert_allclose(log.track_state[0, 3, :2], [5 + 2.4, 0.0], atol=1e-5)
    assert np.isnan(log.track_state[1, 100]).all()
    assert log.lane_edges.tolist() == [[0, 1], [1, 2]]
    assert log.lane_intersection.tolist() == [False, True, False]
    assert log.line_solid.all()
    assert counts["windows"] == log.windows > 10
    write_log(log, tmp_path / "made.npz")
    assert read_log(tmp_path / "made.npz").windows == log.windows


def test_its_windows_know_the_route_and_the_command(file: Path) -> None:
    log, _ = import_commonroad(file)

    for window in Scenes(log):
        s = 5 + SPEED * 0.1 * window.frame
        ahead = [place(at)[2] for at in (s, s + SPEED * 4.5 + 10)]
        turn = np.rad2deg(ahead[1] - ahead[0])
        if abs(turn - 20) > 5:  # near the bound the smoothed line may say either
            assert COMMANDS[window.command] == ("left" if turn > 20 else "straight")
        _, aside = window.route.project(log.track_state[0, window.frame :, :2].astype(float))
        assert np.abs(aside).max() < 0.3
        score = PdmScorer(window).score(human(window)[None])
        assert (score.nc, score.dac) == (1.0, 1.0)


def moved(text: str, by: dict[str, float]) -> str:
    """A scenario with all its places so far away, by axis."""
    return re.sub(r"<([xy])>([^<]*)", lambda at: f"<{at[1]}>{float(at[2]) + by[at[1]]!r}", text)


def test_utm_coordinates_are_as_fine_as_others(file: Path) -> None:
    near, _ = import_commonroad(file)
    file.write_text(moved(scenario(), {"x": 691_000.0, "y": 5_334_000.0}))

    far, counts = import_commonroad(file)

    assert counts["windows"] == near.windows
    assert far.track_state[0, 0, :2].tolist() == [0.0, 0.0]
    start = near.track_state[0, 0, :2]
    np.testing.assert_allclose(
        far.track_state[..., :2], near.track_state[..., :2] - start, atol=1e-4
    )
    np.testing.assert_allclose(far.centre_points, near.centre_points - start, atol=1e-4)
    np.testing.assert_allclose(far.route_points, near.route_points - start, atol=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "field", "found"),
    [
        ("2020a", "2018b", "commonRoad.commonRoadVersion", "2018b"),
        ('timeStepSize="0.2"', 'timeStepSize="often"', "commonRoad", "often"),
        ("leftBound", "leftBand", "commonRoad.lanelet[1].leftBound", "none"),
        ("<type>car</type>", "<type>boat</type>", "dynamicObstacle[10].type", "boat"),
        ("<length>4.5</length>", "<length>0</length>", "dynamicObstacle[10].shape", "0.0"),
        ("<radius>0.3</radius>", "<radius>nan</radius>", "shape.circle.radius", "nan"),
        ("<exact>17</exact>", "<exact>3</exact>", "trajectory.state.time", "3"),
        ("</commonRoad>", "", "file", "no element found"),
        ("commonRoad", "road", "root element", "road"),
    ],
)
def test_what_is_wrong_is_named(file: Path, old: str, new: str, field: str, found: str) -> None:
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))

    with pytest.raises(LogError) as told:
        import_commonroad(file)

    assert field in told.value.field
    assert found in str(told.value)
    assert str(file) in str(told.value)


def test_an_obstacle_without_a_trajectory_is_counted(file: Path) -> None:
    tree = ElementTree.fromstring(file.read_text())
    walker = tree.findall("dynamicObstacle")[1]
    trajectory = walker.find("trajectory")
    assert trajectory is not None
    walker.remove(trajectory)
    file.write_text(ElementTree.tostring(tree, encoding="unicode"))

    log, counts = import_commonroad(file)

    assert len(log.track_type) == 1
    assert counts["dropped: obstacle without a trajectory"] == 1
