"""What NAVSIM alone has: poses of a rear axle, and a map in degrees or UTM coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_navsim import HEADING, SPEED, ZONE, on_the_map, recording, write, write_map

from anchorflow_driving.errors import LogError
from anchorflow_driving.importers.geopackage import utm
from anchorflow_driving.importers.navsim import EGO_AHEAD, import_navsim


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """The pickle, with its map beside it."""
    return write(tmp_path, recording())


def test_tracks_are_those_of_the_boxes_middles(file: Path) -> None:
    log, counts = import_navsim(file, map_file=file.with_name("map.gpkg"))

    t = np.arange(log.frames) * 0.1
    ego, lead, walker = log.track_state.astype(float)
    ahead = np.array([np.cos(HEADING), np.sin(HEADING)])
    np.testing.assert_allclose(ego[:, :2], SPEED * t[:, None] * ahead, atol=1e-4)
    np.testing.assert_allclose(ego[:, 2], HEADING, atol=1e-6)
    np.testing.assert_allclose(ego[:, 3:], [SPEED * ahead] * log.frames, atol=1e-4)
    np.testing.assert_allclose(
        lead[:, :2] - ego[:, :2], [(30 - EGO_AHEAD) * ahead] * len(t), atol=1e-4
    )
    np.testing.assert_allclose(lead[:, 3:], [SPEED * ahead] * log.frames, atol=1e-4)
    np.testing.assert_allclose(np.diff(walker[:, 2]), 0.02, atol=1e-5)
    assert counts["dropped: track seen once"] == 1
    assert counts["dropped: layer carpark_areas, which the map lacks"] == 1
    assert log.frame_token is not None
    told = [frame["token"] for frame in recording()["frames"]]
    assert log.frame_token[::5].tolist() == told  # of 2 Hz
    assert set(np.delete(log.frame_token, np.s_[::5])) == {""}


@pytest.mark.parametrize("system", [4326, ZONE])
def test_its_map_is_what_lies_near(file: Path, tmp_path: Path, system: int) -> None:
    write_map(tmp_path / "other.gpkg", system=system)

    log, _ = import_navsim(file, map_file=tmp_path / "other.gpkg")

    along = np.array([np.cos(HEADING), np.sin(HEADING)])
    origin = np.array([EGO_AHEAD, 0.0])  # of the log, on the street
    (start, *_, end) = log.polylines("centre")[2]
    np.testing.assert_allclose(start @ along, -50 - origin[0], atol=2e-3)
    np.testing.assert_allclose(end @ [-along[1], along[0]], 4.0, atol=2e-3)
    assert len(log.polylines("crosswalk")) == 1
    assert len(log.polylines("drivable")) == 2  # the road and its hole


def test_in_a_bend_the_middle_goes_sideways(tmp_path: Path) -> None:
    made = recording()
    rate, radius = 0.1, SPEED / 0.1
    for k, frame in enumerate(made["frames"]):
        turn = rate * 0.5 * k
        xy = on_the_map([radius * np.sin(turn), radius * (1 - np.cos(turn))])
        half = (HEADING + turn) / 2
        frame["ego2global_translation"] = [*xy, 0.0]
        frame["ego2global_rotation"] = [np.cos(half), 0.0, 0.0, np.sin(half)]

    log, _ = import_navsim(write(tmp_path, made), map_file=tmp_path / "map.gpkg")

    ego = log.track_state[0, ::5].astype(float)  # at the frames of the pickle
    sideways = ego[:, 4] * np.cos(ego[:, 2]) - ego[:, 3] * np.sin(ego[:, 2])
    np.testing.assert_allclose(sideways, rate * EGO_AHEAD, atol=1e-3)


def test_without_a_map_it_says_which(file: Path) -> None:
    with pytest.raises(LogError, match=r"map: expected the map.gpkg of us-nv-las-vegas-strip"):
        import_navsim(file)


# Meridian arc of WGS 84 from the equator to 45 degrees, m.
ARC_45 = 4984944.378


@pytest.mark.parametrize(
    ("longitude", "latitude", "zone", "easting", "northing"),
    [
        (3.0, 0.0, 32631, 500_000.0, 0.0),
        (6.0, 0.0, 32631, 833_978.557, 0.0),  # where zones meet at the equator
        (0.0, 0.0, 32631, 166_021.443, 0.0),
        (3.0, 45.0, 32631, 500_000.0, 0.9996 * ARC_45),
        (3.0, -45.0, 32731, 500_000.0, 1e7 - 0.9996 * ARC_45),
    ],
)
def test_utm_is_what_is_published(
    longitude: float, latitude: float, zone: int, easting: float, northing: float
) -> None:
    found = utm(np.array([longitude, latitude]), zone)

    np.testing.assert_allclose(found, [easting, northing], rtol=0, atol=1e-3)


def test_utm_is_conformal() -> None:
    """Steps to the north and to the east are as long and at right angles."""
    here, step = np.array([-115.0, 36.1]), 1e-5
    origin, east, north = utm(here + np.array([[0.0, 0.0], [step, 0.0], [0.0, step]]), 32611)

    phi = np.deg2rad(here[1])
    eccentricity2 = 2 / 298.257223563 - 1 / 298.257223563**2
    # Metres of a step on the ellipsoid: radii of curvature of the parallel and of the meridian.
    across = 6378137.0 / np.sqrt(1 - eccentricity2 * np.sin(phi) ** 2)
    along = across * (1 - eccentricity2) / (1 - eccentricity2 * np.sin(phi) ** 2)
    east, north = east - origin, north - origin
    assert east @ north == pytest.approx(0.0, abs=1e-6)
    scale_east = np.hypot(*east) / (np.deg2rad(step) * across * np.cos(phi))
    scale_north = np.hypot(*north) / (np.deg2rad(step) * along)
    assert scale_east == pytest.approx(scale_north, rel=1e-6)
    assert 0.9996 < scale_east < 1.001
