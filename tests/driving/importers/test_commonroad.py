"""What CommonRoad alone has: routes round bends, UTM coordinates, occupancy sets."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from made_commonroad import SPEED, place, recording, write

from anchorflow_driving.importers.commonroad import import_commonroad
from anchorflow_driving.log import COMMANDS
from anchorflow_driving.window import Scenes


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write(tmp_path, recording())


def test_its_windows_know_the_route_and_the_command(file: Path) -> None:
    log, _ = import_commonroad(file)

    np.testing.assert_allclose(log.track_state[0, 3, :2], [5 + 2.4, 0.0], atol=1e-5)
    assert np.isnan(log.track_state[1, 100]).all()
    assert log.line_solid.all()
    for window in Scenes(log):
        s = 5 + SPEED * 0.1 * window.frame
        ahead = [place(at)[2] for at in (s, s + SPEED * 4.5 + 10)]
        turn = np.rad2deg(ahead[1] - ahead[0])
        if abs(turn - 20) > 5:  # near the bound the smoothed line may say either
            assert COMMANDS[window.command] == ("left" if turn > 20 else "straight")
        _, aside = window.route.project(log.track_state[0, window.frame :, :2].astype(float))
        assert np.abs(aside).max() < 0.3


def moved(text: str, by: dict[str, float]) -> str:
    """A scenario with all its places so far away, by axis."""
    return re.sub(r"<([xy])>([^<]*)", lambda at: f"<{at[1]}>{float(at[2]) + by[at[1]]!r}", text)


def test_utm_coordinates_are_as_fine_as_others(file: Path) -> None:
    near, _ = import_commonroad(file)
    file.write_text(moved(file.read_text(), {"x": 691_000.0, "y": 5_334_000.0}))

    far, counts = import_commonroad(file)

    assert counts["windows"] == near.windows
    assert far.track_state[0, 0, :2].tolist() == [0.0, 0.0]
    start = near.track_state[0, 0, :2]
    np.testing.assert_allclose(
        far.track_state[..., :2], near.track_state[..., :2] - start, atol=1e-4
    )
    np.testing.assert_allclose(far.centre_points, near.centre_points - start, atol=1e-4)
    np.testing.assert_allclose(far.route_points, near.route_points - start, atol=1e-3)


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
