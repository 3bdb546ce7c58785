"""NAVSIM logs made here, with a map as nuPlan's: two lanes, an ego behind another car."""

from __future__ import annotations

import pickle
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_cli.main import main
from anchorflow_driving.drivers import human
from anchorflow_driving.errors import LogError
from anchorflow_driving.importers.geopackage import utm
from anchorflow_driving.importers.navsim import CONNECTORS, EGO_AHEAD, EGO_SIZE, import_navsim
from anchorflow_driving.log import PEDESTRIAN, VEHICLE, read_log, write_log
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes

ZONE, CORNER, HEADING = 32611, np.array([664_000.0, 3_997_000.0]), 0.6
FRAMES, SPEED = 25, 8.0
BEGIN = 1_624_000_000_000_000


def on_the_map(points: Any) -> np.ndarray:
    """UTM coordinates of points [..., 2] along and left of the street."""
    cos, sin = np.cos(HEADING), np.sin(HEADING)
    return CORNER + np.asarray(points, float) @ [[cos, sin], [-sin, cos]]


def frames(scene: str = "scene-a") -> list[dict]:
    made = []
    for k in range(FRAMES):
        x = SPEED * 0.5 * k
        boxes = [
            [30.0, 0.0, 0.8, 4.6, 1.9, 1.6, 0.0],
            [60.0 - x, -4.0, 0.9, 0.6, 0.7, 1.8, 3.0 + 0.1 * k],
        ]
        names, tokens = ["vehicle", "pedestrian"], ["car", "walker"]
        if k == 3:
            boxes.append([5.0, 5.0, 0.5, 0.4, 0.4, 0.7, 0.0])
            names.append("traffic_cone")
            tokens.append("cone")
        pose = [np.cos(HEADING / 2), 0.0, 0.0, np.sin(HEADING / 2)]
        made.append(
            {
                "token": f"{scene}-{k}",
                "timestamp": BEGIN + 500_000 * k,
                "log_name": "2021.06.14",
                "scene_token": scene,
                "map_location": "us-nv-las-vegas-strip",
                "ego2global_translation": np.array([*on_the_map([x, 0.0]), 0.0]),
                "ego2global_rotation": np.array(pose),
                "ego_dynamic_state": [SPEED, 0.0, 0.0, 0.0],
                "driving_command": np.array([0, 1, 0, 0]),
                "anns": {
                    "gt_boxes": np.array(boxes, np.float32),
                    "gt_names": np.array(names),
                    "track_tokens": tokens,
                },
            }
        )
    return made


def degrees(points: np.ndarray) -> np.ndarray:
    """Longitude and latitude of UTM coordinates [V, 2], by Newton's method."""
    found: Any = np.full_like(points, [-115.0, 36.0])
    step = 1e-4
    for _ in range(6):
        here = utm(found, ZONE)
        slopes = [(utm(found + axis, ZONE) - here) / step for axis in np.eye(2) * step]
        jacobian = np.stack(slopes, -1)
        found = found + np.linalg.solve(jacobian, (points - here)[..., None])[..., 0]
    return found


def blob(*rings: Any, polygon: bool = True, system: int = 4326) -> bytes:
    """A GeoPackage's geometry; lines have no z here, polygons do."""
    body = struct.pack("<2sBBi", b"GP", 0, 1, system)
    corners = [on_the_map(ring) for ring in rings]
    if system == 4326:
        corners = [degrees(ring) for ring in corners]
    if not polygon:
        return body + struct.pack("<BII", 1, 2, len(corners[0])) + corners[0].tobytes()
    body += struct.pack("<BII", 1, 6, 1) + struct.pack("<BII", 1, 1003, len(rings))
    for ring in corners:
        body += struct.pack("<I", len(ring)) + np.column_stack([ring, 0 * ring[:, 0]]).tobytes()
    return body


def rectangle(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float]]:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]


def write_map(path: Path, *, left_out: str = "", system: int = 4326) -> Path:
    def area(*rings: Any) -> bytes:
        return blob(*rings, system=system)

    def line(x0: float, x1: float, y: float) -> bytes:
        points = [(x, y) for x in np.linspace(x0, x1, 9)]
        return blob(points, polygon=False, system=system)

    road = area(rectangle(-50, -2, 250, 6), rectangle(150, 3, 160, 5))
    layers: dict[str, tuple[list[str], list[tuple]]] = {
        "lanes_polygons": (
            ["fid", "geom"],
            [
                (1, area(rectangle(-50, -2, 80, 2))),
                (2, area(rectangle(90, -2, 250, 2))),
                (3, area(rectangle(-50, 2, 250, 6))),
                (4, area(rectangle(5000, 2, 5010, 6))),
            ],
        ),
        CONNECTORS: (["lane_connector_fid", "geom"], [("1", area(rectangle(80, -2, 90, 2)))]),
        "lane_connectors": (
            ["fid", "exit_lane_fid", "entry_lane_fid", "geom"],
            [(1, 1, 2, line(80, 90, 0))],
        ),
        "baseline_paths": (
            ["lane_fid", "lane_connector_fid", "geom"],
            [
                (1.0, None, line(-50, 80, 0)),
                (2.0, None, line(90, 250, 0)),
                (3.0, None, line(-50, 250, 4)),
                (None, 1.0, line(80, 90, 0)),
            ],
        ),
        "lane_groups_polygons": (["geom"], [(road,)]),
        "intersections": (["geom"], [(area(rectangle(78, -2, 92, 6)),)]),
        "lane_group_connectors": (["geom"], []),
        "crosswalks": (["geom"], [(area(rectangle(120, -2, 124, 6)),)]),
    }
    file = sqlite3.connect(path)
    file.execute("CREATE TABLE gpkg_geometry_columns (table_name, column_name)")
    file.execute("CREATE TABLE meta (key, value)")
    file.execute("INSERT INTO meta VALUES ('projectedCoordSystem', 'epsg:32611')")
    for name, (columns, rows) in layers.items():
        columns = [column for column in columns if f"{name}.{column}" != left_out]
        if name == left_out:
            continue
        file.execute(f"CREATE TABLE {name} ({', '.join(columns)})")
        file.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom')", (name,))
        marks = ", ".join("?" * len(columns))
        file.executemany(
            f"INSERT INTO {name} VALUES ({marks})", [row[-len(columns) :] for row in rows]
        )
    file.commit()
    file.close()
    return path


@pytest.fixture(scope="module")
def map_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_map(tmp_path_factory.mktemp("maps") / "map.gpkg")


def write(path: Path, made: Any) -> Path:
    path.write_bytes(pickle.dumps(made, protocol=pickle.HIGHEST_PROTOCOL))
    return path


def test_a_scene_becomes_a_log(tmp_path: Path, map_file: Path) -> None:
    log, counts = import_navsim(write(tmp_path / "a.pkl", frames()), map_file=map_file)

    assert (log.name, log.source) == ("2021.06.14 scene-a", "navsim")
    assert log.city == "us-nv-las-vegas-strip"
    assert log.track_type.tolist() == [VEHICLE, VEHICLE, PEDESTRIAN]
    np.testing.assert_allclose(log.track_size, [EGO_SIZE, (4.6, 1.9), (0.6, 0.7)], rtol=1e-5)
    assert log.frames == 5 * (FRAMES - 1) + 1
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
    assert counts["windows"] == log.windows > 5
    write_log(log, tmp_path / "made.npz")
    assert read_log(tmp_path / "made.npz").windows == log.windows


@pytest.mark.parametrize("system", [4326, ZONE])
def test_its_map_is_what_lies_near(tmp_path: Path, system: int) -> None:
    file = write_map(tmp_path / "map.gpkg", system=system)

    log, _ = import_navsim(write(tmp_path / "a.pkl", frames()), map_file=file)

    assert log.lane_intersection.tolist() == [False, False, False, True]
    assert sorted(log.lane_edges.tolist()) == [[0, 3], [3, 1]]
    along = np.array([np.cos(HEADING), np.sin(HEADING)])
    origin = np.array([EGO_AHEAD, 0.0])  # of the log, on the street
    (start, *_, end) = log.polylines("centre")[2]
    np.testing.assert_allclose(start @ along, -50 - origin[0], atol=2e-3)
    np.testing.assert_allclose(end @ [-along[1], along[0]], 4.0, atol=2e-3)
    assert len(log.polylines("crosswalk")) == 1
    assert len(log.polylines("drivable")) == 2  # the road and its hole


def test_its_windows_can_be_driven(tmp_path: Path, map_file: Path) -> None:
    log, _ = import_navsim(write(tmp_path / "a.pkl", frames()), map_file=map_file)

    assert set(log.window_ego.tolist()) == {0, 1}
    for window in Scenes(log):
        score = PdmScorer(window).score(human(window)[None])
        assert (score.nc, score.dac) == (1.0, 1.0)


def test_in_a_bend_the_middle_goes_sideways(tmp_path: Path, map_file: Path) -> None:
    made = frames()
    rate, radius = 0.1, SPEED / 0.1
    for k, frame in enumerate(made):
        turn = rate * 0.5 * k
        xy = on_the_map([radius * np.sin(turn), radius * (1 - np.cos(turn))])
        half = (HEADING + turn) / 2
        frame["ego2global_translation"] = [*xy, 0.0]
        frame["ego2global_rotation"] = [np.cos(half), 0.0, 0.0, np.sin(half)]

    log, _ = import_navsim(write(tmp_path / "a.pkl", made), map_file=map_file)

    ego = log.track_state[0, ::5].astype(float)  # at the frames of the pickle
    sideways = ego[:, 4] * np.cos(ego[:, 2]) - ego[:, 3] * np.sin(ego[:, 2])
    np.testing.assert_allclose(sideways, rate * EGO_AHEAD, atol=1e-3)


def test_several_scenes_are_told_apart(tmp_path: Path, map_file: Path) -> None:
    file = write(tmp_path / "a.pkl", frames() + frames("scene-b"))

    log, _ = import_navsim(file, map_file=map_file, scene="scene-b")
    with pytest.raises(LogError, match="expected one of scene-a, scene-b, found no name"):
        import_navsim(file, map_file=map_file)

    assert log.name.endswith("scene-b")


def test_without_a_map_it_says_which(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"map: expected the map.gpkg of us-nv-las-vegas-strip"):
        import_navsim(write(tmp_path / "a.pkl", frames()))


def change(*keys: str, to: object) -> Callable[[list[dict]], object]:
    def apply(made: list[dict]) -> object:
        *outer, last = keys
        place = made[2]
        for key in outer:
            place = place[key]
        if to is None:
            del place[last]
        else:
            place[last] = to
        return made

    return apply


@pytest.mark.parametrize(
    ("broken", "field", "found"),
    [
        (change("ego2global_translation", to=None), "[scene-a-2].ego2global_translation", "none"),
        (change("ego2global_rotation", to=[1.0]), "[scene-a-2].ego2global_rotation", "[1]"),
        (change("ego_dynamic_state", to=[np.nan] * 4), "ego_dynamic_state", "NaN"),
        (change("timestamp", to=BEGIN), "[scene-a-2].timestamp", "-0.5 s"),
        (change("anns", to=None), "[scene-a-2].anns", "none"),
        (change("anns", "gt_boxes", to=np.zeros((2, 9))), "anns.gt_boxes", "[2, 9]"),
        (change("anns", "gt_boxes", to=np.zeros((2, 7))), "anns.gt_boxes", "0.0"),
        (change("anns", "gt_names", to=["vehicle"]), "anns.gt_names", "['vehicle']"),
        (change("anns", "gt_names", to=["vehicle", "boat"]), "anns.gt_names", "'boat'"),
        (change("anns", "track_tokens", to=["a", "a"]), "anns.track_tokens", "twice"),
        (lambda made: {"frames": made}, "root", "dict"),
        (lambda _: [], "scene_token", "no name"),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, map_file: Path, broken: Callable, field: str, found: str
) -> None:
    file = write(tmp_path / "broken.pkl", broken(frames()))

    with pytest.raises(LogError) as told:
        import_navsim(file, map_file=map_file)

    assert told.value.path == str(file)
    assert told.value.field.endswith(field)
    assert found in str(told.value)


@pytest.mark.parametrize(
    ("left_out", "field"),
    [
        ("lanes_polygons", "lanes_polygons"),
        ("baseline_paths.lane_fid", "baseline_paths.lane_fid"),
        ("crosswalks", "crosswalks"),
    ],
)
def test_a_missing_layer_or_column_is_named(tmp_path: Path, left_out: str, field: str) -> None:
    file = write_map(tmp_path / "map.gpkg", left_out=left_out)

    with pytest.raises(LogError) as told:
        import_navsim(write(tmp_path / "a.pkl", frames()), map_file=file)

    assert (told.value.path, told.value.field) == (str(file), field)


@pytest.mark.parametrize(
    ("statement", "field", "found"),
    [
        ("UPDATE crosswalks SET geom = x'00'", "crosswalks.geom", "no geometry"),
        ("UPDATE crosswalks SET geom = substr(geom, 1, 40)", "crosswalks.geom", ""),
        ("UPDATE meta SET value = 'epsg:4326'", "meta.projectedCoordSystem", "epsg:4326"),
        ("DELETE FROM meta", "meta.key", ""),
        ("DELETE FROM baseline_paths WHERE lane_fid = 2", "baseline_paths", "lane 2"),
        ("DELETE FROM lanes_polygons", "lanes_polygons", ""),
    ],
)
def test_what_is_wrong_in_the_map_is_named(
    tmp_path: Path, statement: str, field: str, found: str
) -> None:
    file = write_map(tmp_path / "map.gpkg")
    with sqlite3.connect(file) as opened:
        opened.execute(statement)
        if field == "lanes_polygons":
            opened.execute(f"DELETE FROM {CONNECTORS}")
    opened.close()

    with pytest.raises(LogError) as told:
        import_navsim(write(tmp_path / "a.pkl", frames()), map_file=file)

    assert (told.value.path, told.value.field) == (str(file), field)
    assert found in str(told.value)


def test_what_is_no_geopackage_is_named(tmp_path: Path) -> None:
    file = tmp_path / "map.gpkg"
    file.write_bytes(b"no database" * 100)

    with pytest.raises(LogError, match=r"map\.gpkg: file: expected a GeoPackage"):
        import_navsim(write(tmp_path / "a.pkl", frames()), map_file=file)


def test_the_command_knows_the_layout(tmp_path: Path, map_file: Path) -> None:
    file = write(tmp_path / "a.pkl", frames())
    out = tmp_path / "made.npz"

    with pytest.raises(SystemExit) as ended:
        main(
            [
                "data",
                "import-log",
                str(file),
                "--unpickle",
                "--map",
                str(map_file),
                "--out",
                str(out),
            ]
        )

    assert not ended.value.code
    assert read_log(out).windows > 5


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
