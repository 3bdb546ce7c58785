"""What holds for every importer, each on a recording of its layout that is made here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from made_navsim import BEGIN, CONNECTORS

from anchorflow_cli.main import main
from anchorflow_driving.drivers import human
from anchorflow_driving.errors import LogError
from anchorflow_driving.importers import Layout, layout_of
from anchorflow_driving.log import PEDESTRIAN, VEHICLE, DrivingLog, read_log, write_log
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes

Change = Callable[[dict[str, Any]], None]
MISSING = object()


class Expected(NamedTuple):
    """The log of a recording; its last track is a pedestrian, the others are vehicles."""

    name: str
    city: str
    sizes: list[tuple[float, float]]
    frames: int
    edges: list[list[int]]
    in_junction: list[int]


CAR, WALKER, A_AB_B = (4.6, 1.9), (0.6, 0.6), [[0, 3], [3, 1]]
EXPECTED = {
    "commonroad": Expected("MADE_Up-1_1_T-1", "", [(4.5, 1.8), WALKER], 179, [[0, 1], [1, 2]], [1]),
    "argoverse": Expected("0a0a-made", "austin", [(4.87, 1.85), CAR, WALKER], 110, [[0, 1]], [1]),
    "nuscenes": Expected(
        "scene-0001", "singapore-made", [(4.084, 1.73), CAR, (0.7, 0.6)], 121, A_AB_B, [3]
    ),
    "navsim": Expected(
        "2021.06.14 scene-a",
        "us-nv-las-vegas-strip",
        [(5.176, 2.297), CAR, (0.6, 0.7)],
        121,
        A_AB_B,
        [3],
    ),
}
EACH = pytest.mark.parametrize("layout", EXPECTED)


def written(layout: str, folder: Path, *scenes: str, change: Change = lambda _: None) -> Path:
    """Write a recording, changed before that."""
    if layout == "argoverse":
        pytest.importorskip("pyarrow", reason="pyarrow reads parquet: pip install pyarrow")
    made = import_module(f"made_{layout}")
    recording = made.recording(*scenes)
    change(recording)
    return made.write(folder, recording)


def imported(layout: str, path: Path, **options: Any) -> tuple[DrivingLog, Counter[str]]:
    if layout == "navsim":
        options["map_file"] = path.with_name("map.gpkg")
    importer = import_module(f"anchorflow_driving.importers.{layout}")
    return getattr(importer, f"import_{layout}")(path, **options)


@EACH
def test_a_recording_becomes_a_log_whose_windows_can_be_driven(tmp_path: Path, layout: str) -> None:
    expected = EXPECTED[layout]

    log, counts = imported(layout, written(layout, tmp_path))

    assert (log.name, log.city) == (expected.name, expected.city)
    assert log.source == Layout[layout.upper()].value
    vehicles = len(expected.sizes) - 1
    assert log.track_type.tolist() == [VEHICLE] * vehicles + [PEDESTRIAN]
    np.testing.assert_allclose(log.track_size, expected.sizes, rtol=1e-5)
    assert log.frames == expected.frames
    assert sorted(log.lane_edges.tolist()) == expected.edges
    assert np.flatnonzero(log.lane_intersection).tolist() == expected.in_junction
    assert counts["windows"] == log.windows > 5
    assert set(log.window_ego.tolist()) == set(range(vehicles))
    for window in Scenes(log):
        score = PdmScorer(window).score(human(window)[None])
        assert (score.nc, score.dac) == (1.0, 1.0)
    write_log(log, tmp_path / "made.npz")
    assert read_log(tmp_path / "made.npz").windows == log.windows


@EACH
def test_the_command_knows_the_layout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str
) -> None:
    path = written(layout, tmp_path)
    monkeypatch.chdir(tmp_path)
    options = ["--unpickle", "--map", "map.gpkg"] if layout == "navsim" else []

    with pytest.raises(SystemExit) as ended:
        main(["data", "import-log", str(path), *options, "--out", "made.npz"])

    assert not ended.value.code
    assert read_log(tmp_path / "made.npz").windows > 5


@pytest.mark.parametrize(
    ("layout", "scenes"),
    [("nuscenes", ("scene-0001", "scene-0002")), ("navsim", ("scene-a", "scene-b"))],
)
def test_several_scenes_are_told_apart(
    tmp_path: Path, layout: str, scenes: tuple[str, str]
) -> None:
    path = written(layout, tmp_path, *scenes)

    log, _ = imported(layout, path, scene=scenes[1])
    with pytest.raises(LogError, match=f"expected one of {', '.join(scenes)}, found no name"):
        imported(layout, path)

    assert log.name.endswith(scenes[1])


def put(*keys: Any, to: Any = MISSING) -> Change:
    """Change, or by default take away, what stands at a place of a recording."""

    def change(made: Any) -> None:
        *outer, last = keys
        for key in outer:
            made = made[key]
        if to is MISSING:
            del made[last]
        else:
            made[last] = to

    return change


def text(old: str, new: str) -> Change:
    def change(made: dict[str, str]) -> None:
        assert old in made["xml"]
        made["xml"] = made["xml"].replace(old, new)

    return change


def without_heading(made: dict[str, Any]) -> None:
    for each in made["states"]:
        del each["heading"]


def state(column: str, value: object) -> Change:
    return put("states", 0, column, to=value)


def lane(key: str, value: object) -> Change:
    return put("map", "lane_segments", "1", key, to=value)


def row(table: str, key: str, value: Any = MISSING) -> Change:
    return put("tables", table, 0, key, to=value)


def box(key: str, value: Any = MISSING) -> Change:
    return row("sample_annotation", key, value)


def frame(*keys: str, to: Any = MISSING) -> Change:
    return put("frames", 2, *keys, to=to)


def sql(*statements: str) -> Change:
    return put("statements", to=statements)


# The change, the ends of the file's path and of the field, and part of the message.
WRONG: dict[str, list[tuple[Change, str, str, str]]] = {
    "commonroad": [
        (text("2020a", "2018b"), "made.xml", "commonRoad.commonRoadVersion", "2018b"),
        (text('StepSize="0.2"', 'StepSize="often"'), "made.xml", "commonRoad", "often"),
        (text("leftBound", "leftBand"), "made.xml", "commonRoad.lanelet[1].leftBound", "none"),
        (text("<type>car", "<type>boat"), "made.xml", "dynamicObstacle[10].type", "boat"),
        (text("<length>4.5", "<length>0"), "made.xml", "dynamicObstacle[10].shape", "0.0"),
        (text("<radius>0.3", "<radius>nan"), "made.xml", "shape.circle.radius", "nan"),
        (text("<exact>17</", "<exact>3</"), "made.xml", "trajectory.state.time", "3"),
        (text("</commonRoad>", ""), "made.xml", "file", "no element found"),
        (text("commonRoad", "road"), "made.xml", "root element", "road"),
    ],
    "argoverse": [
        (without_heading, "made.parquet", "heading", "none"),
        (state("velocity_x", float("nan")), "made.parquet", "velocity_x", "double"),
        (state("position_y", None), "made.parquet", "position_y", "double"),
        (state("object_type", "boat"), "made.parquet", "object_type of track 7", "boat"),
        (state("timestep", 1), "made.parquet", "timestep of track 7", "[1.0, 1.0"),
        (put("states", slice(110, None)), "made.parquet", "track_id", "none"),
        (put("states", to=[]), "made.parquet", "scenario_id", "none"),
        (put("states", to=b"PAR1"), "made.parquet", "file", "expected a parquet file"),
        (lane("successors", None), "made.json", "lane_segments.1.successors", "none"),
        (lane("is_intersection", 1), "made.json", "lane_segments.1.is_intersection", "int"),
        (lane("left_lane_boundary", [{"x": 1.0}]), "made.json", "left_lane_boundary[0].y", ""),
        (put("map"), "", "folder", "expected one log_map_archive_*.json, found none"),
    ],
    "nuscenes": [
        (box("rotation"), "sample_annotation.json", "rotation", "none"),
        (box("size", [1.0, 2.0]), "sample_annotation.json", "size", "[2]"),
        (box("size", [1.0, 0.0, 1.0]), "sample_annotation.json", "size", "0.0"),
        (box("translation", ["a"] * 3), "sample_annotation.json", "translation", "<U"),
        (row("sample", "timestamp", float("nan")), "sample.json", "timestamp", "NaN"),
        (row("instance", "category_token", "x"), "instance.json", "category_token", "'x'"),
        (row("category", "name", "flat"), "category.json", "name", "flat"),
        (row("log", "location", "mars"), "mars.json", "file", "No such file"),
        (put("tables", "ego_pose"), "ego_pose.json", "file", "expected a JSON file"),
        (put("map", "lane", 0, "polygon_token", to="x"), "made.json", "[a].polygon_token", "'x'"),
        (put("map", "node", 0, "x"), "made.json", "node[n0].x", "none"),
        # A lane's polygon may do without holes; the road's may not.
        (put("map", "polygon", -1, "holes"), "made.json", "polygon[road].holes", "none"),
    ],
    "navsim": [
        (frame("ego2global_translation"), "a.pkl", "[scene-a-2].ego2global_translation", "none"),
        (frame("ego2global_rotation", to=[1.0]), "a.pkl", "2].ego2global_rotation", "[1]"),
        (frame("ego_dynamic_state", to=[np.nan] * 4), "a.pkl", "ego_dynamic_state", "NaN"),
        (frame("timestamp", to=BEGIN), "a.pkl", "[scene-a-2].timestamp", "-0.5 s"),
        (frame("anns"), "a.pkl", "[scene-a-2].anns", "none"),
        (frame("anns", "gt_boxes", to=np.zeros((2, 9))), "a.pkl", "anns.gt_boxes", "[2, 9]"),
        (frame("anns", "gt_boxes", to=np.zeros((2, 7))), "a.pkl", "anns.gt_boxes", "0.0"),
        (frame("anns", "gt_names", to=["vehicle"]), "a.pkl", "anns.gt_names", "['vehicle']"),
        (frame("anns", "gt_names", to=["vehicle", "boat"]), "a.pkl", "gt_names", "'boat'"),
        (frame("anns", "track_tokens", to=["a", "a"]), "a.pkl", "anns.track_tokens", "twice"),
        (put("frames", to={"frames": []}), "a.pkl", "root", "dict"),
        (put("frames", to=[]), "a.pkl", "scene_token", "no name"),
        (put("left_out", to="lanes_polygons"), "map.gpkg", "lanes_polygons", ""),
        (put("left_out", to="crosswalks"), "map.gpkg", "crosswalks", ""),
        (put("left_out", to="baseline_paths.lane_fid"), "map.gpkg", "paths.lane_fid", ""),
        (put("map", to=b"no database" * 100), "map.gpkg", "file", "expected a GeoPackage"),
        (sql("UPDATE crosswalks SET geom = x'00'"), "map.gpkg", "crosswalks.geom", "no geometry"),
        (sql("UPDATE crosswalks SET geom = substr(geom, 1, 40)"), "map.gpkg", "walks.geom", ""),
        (sql("UPDATE meta SET value = 'epsg:4326'"), "map.gpkg", "CoordSystem", "epsg:4326"),
        (sql("DELETE FROM meta"), "map.gpkg", "meta.key", ""),
        (sql("DELETE FROM baseline_paths WHERE lane_fid = 2"), "gpkg", "baseline_paths", "lane 2"),
        (sql(*map("DELETE FROM {}".format, ("lanes_polygons", CONNECTORS))), "gpkg", "gons", ""),
    ],
}


@pytest.mark.parametrize(
    ("layout", "change", "file", "field", "found"),
    [(layout, *case) for layout, cases in WRONG.items() for case in cases],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, layout: str, change: Change, file: str, field: str, found: str
) -> None:
    path = written(layout, tmp_path, change=change)

    with pytest.raises(LogError) as told:
        imported(layout, path)

    assert told.value.path.endswith(file)
    assert told.value.field.endswith(field)
    assert str(told.value).startswith(f"{told.value.path}: ")
    assert found in str(told.value)


@pytest.mark.parametrize(
    ("made", "asked", "layout"),
    [
        ("a.xml", "a.xml", Layout.COMMONROAD),
        ("A.XML", "A.XML", Layout.COMMONROAD),
        ("a.pkl", "a.pkl", Layout.NAVSIM),
        ("scenario_1.parquet", "scenario_1.parquet", Layout.ARGOVERSE),
        ("in/scenario_1.parquet", "in", Layout.ARGOVERSE),
        ("in/v1.0-mini/scene.json", "in", Layout.NUSCENES),
        ("in/v1.0-mini/scene.json", "in/v1.0-mini", Layout.NUSCENES),
        ("a.csv", "a.csv", "found .csv"),
        ("in/a.xml", "in", "found none of them"),
        ("a.xml", "b.xml", "found nothing"),
    ],
)
def test_a_layout_is_known_or_refused(
    tmp_path: Path, made: str, asked: str, layout: Layout | str
) -> None:
    (tmp_path / made).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / made).touch()

    if isinstance(layout, Layout):
        assert layout_of(tmp_path / asked) is layout
    else:
        with pytest.raises(LogError, match=layout):
            layout_of(tmp_path / asked)
