"""nuScenes tables and map made here: two lanes straight on, an ego behind another car."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_cli.main import main
from anchorflow_driving.drivers import human
from anchorflow_driving.errors import LogError
from anchorflow_driving.importers.fields import Entry
from anchorflow_driving.importers.nuscenes import EGO_AHEAD, EGO_SIZE, import_nuscenes
from anchorflow_driving.importers.nuscenes_map import arc_points
from anchorflow_driving.log import PEDESTRIAN, VEHICLE, read_log, write_log
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes

Tables = dict[str, Any]

SECONDS, SPEED = 12, 8.0
BEGIN = 1_531_883_530_449_377  # microseconds
ORIGIN = (410.0, 1170.0)


def rotation(heading: float) -> list[float]:
    return [float(np.cos(heading / 2)), 0.0, 0.0, float(np.sin(heading / 2))]


def place(x: float, y: float) -> list[float]:
    return [ORIGIN[0] + x, ORIGIN[1] + y, 0.5]


def scene_tables(name: str = "scene-0001") -> Tables:
    samples = [
        {"token": f"{name}-s{k}", "scene_token": name, "timestamp": BEGIN + 500_000 * k}
        for k in range(2 * SECONDS + 1)
    ]
    annotations = []
    for k, sample in enumerate(samples):
        lead = {"instance_token": "car", "translation": place(30 + SPEED / 2 * k, 0.2)}
        # Turns on the spot, through the jump of the angle.
        walker = {"instance_token": "walker", "translation": place(60.0, -4.0)}
        for box, size, heading in (
            (lead, [1.9, 4.6, 1.7], 0.0),
            (walker, [0.6, 0.7, 1.8], 3.0 + 0.1 * k),
        ):
            annotations.append(
                box
                | {
                    "token": f"{box['instance_token']}{k}",
                    "sample_token": sample["token"],
                    "size": size,
                    "rotation": rotation(heading),
                }
            )
    annotations.append(annotations[0] | {"token": "cone0", "instance_token": "cone"})
    poses = [
        {
            "token": f"{name}-p{k}",
            "timestamp": BEGIN + 50_000 * k,
            "translation": [*place(SPEED * 0.05 * k, 0.0)[:2], 0.0],
            "rotation": rotation(0.0),
        }
        for k in range(20 * SECONDS + 1)
    ]
    data = [
        {
            "token": pose["token"],
            "ego_pose_token": pose["token"],
            "sample_token": samples[min(k // 10, len(samples) - 1)]["token"],
        }
        for k, pose in enumerate(poses)
    ]
    return {
        "scene": [{"token": name, "name": name, "log_token": "log"}],
        "sample": samples,
        "sample_annotation": annotations,
        "sample_data": data,
        "ego_pose": poses,
        "instance": [
            {"token": "car", "category_token": "vehicle.car"},
            {"token": "walker", "category_token": "human"},
            {"token": "cone", "category_token": "cone"},
        ],
        "category": [
            {"token": "vehicle.car", "name": "vehicle.car"},
            {"token": "human", "name": "human.pedestrian.adult"},
            {"token": "cone", "name": "movable_object.trafficcone"},
        ],
        "log": [{"token": "log", "location": "singapore-made"}],
    }


class Nodes:
    """The points of a map, and what is drawn through them."""

    def __init__(self) -> None:
        self.rows: list[dict] = []

    def line(self, *places: tuple[float, float]) -> list[str]:
        """Their tokens."""
        tokens = [f"n{len(self.rows) + k}" for k in range(len(places))]
        for token, (x, y) in zip(tokens, places, strict=True):
            east, north, _ = place(x, y)
            self.rows.append({"token": token, "x": east, "y": north})
        return tokens

    def rectangle(self, token: str, x0: float, y0: float, x1: float, y1: float) -> dict:
        ring = self.line((x0, y0), (x1, y0), (x1, y1), (x0, y1))
        return {"token": token, "exterior_node_tokens": ring, "holes": []}


def straight(x0: float, x1: float, y: float) -> list[dict]:
    start = [*place(x0, y)[:2], 0.0]
    lengths = [0.0, x1 - x0, 0.0]
    return [{"start_pose": start, "shape": "LSR", "radius": 50.0, "segment_length": lengths}]


def road() -> Tables:
    """Lanes a, ab, b on y = 0, lane c beside them, one far away, and a hole in the road."""
    nodes = Nodes()
    whole = nodes.rectangle("road", -50, -2, 250, 6)
    whole["holes"] = [{"node_tokens": nodes.line((150, 3), (160, 3), (160, 5), (150, 5))}]
    return {
        **lanes(),
        "polygon": [
            nodes.rectangle("A", -50, -2, 80, 2),
            nodes.rectangle("B", 90, -2, 250, 2),
            nodes.rectangle("C", -50, 2, 250, 6),
            nodes.rectangle("walk", 120, -2, 124, 6),
            nodes.rectangle("far", 5000, 5000, 5010, 5010),
            whole,
        ],
        "drivable_area": [{"token": "d", "polygon_tokens": ["road"]}],
        "ped_crossing": [{"token": "p", "polygon_token": "walk"}],
        "lane_divider": [{"token": "ld", "lane_divider_segments": divider(nodes)}],
        "road_divider": [{"token": "rd", "line_token": "edge"}],
        "line": [{"token": "edge", "node_tokens": nodes.line((-50, -2), (250, -2))}],
        "node": nodes.rows,
    }


def lanes() -> Tables:
    polygons = {"a": "A", "b": "B", "c": "C", "far": "far"}
    return {
        "lane": [{"token": lane, "polygon_token": of} for lane, of in polygons.items()],
        "lane_connector": [{"token": "ab"}],
        "arcline_path_3": {
            "a": straight(-50, 80, 0),
            "ab": straight(80, 90, 0),
            "b": straight(90, 250, 0),
            "c": straight(-50, 250, 4),
            "far": straight(5000, 5010, 5005),
        },
        "connectivity": {
            "a": {"incoming": [], "outgoing": ["ab"]},
            "ab": {"incoming": ["a"], "outgoing": ["b"]},
            "b": {"incoming": ["ab"], "outgoing": ["gone"]},
            "c": {"incoming": [], "outgoing": []},
        },
    }


def divider(nodes: Nodes) -> list[dict]:
    """Dashed up to x = 100, then solid."""
    tokens = nodes.line((-50, 2), (0, 2), (100, 2), (250, 2))
    kinds = ("NIL", "DOUBLE_DASHED_WHITE", "SINGLE_SOLID_WHITE", "SINGLE_SOLID_WHITE")
    return [
        {"node_token": token, "segment_type": kind}
        for token, kind in zip(tokens, kinds, strict=True)
    ]


def write(folder: Path, tables: Tables, map_expansion: Tables) -> Path:
    (folder / "v1.0-mini").mkdir(parents=True)
    for name, rows in tables.items():
        (folder / "v1.0-mini" / f"{name}.json").write_text(json.dumps(rows))
    (folder / "maps" / "expansion").mkdir(parents=True)
    file = folder / "maps" / "expansion" / "singapore-made.json"
    file.write_text(json.dumps(map_expansion))
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(tmp_path / "nuscenes", scene_tables(), road())


def test_a_scene_becomes_a_log(folder: Path, tmp_path: Path) -> None:
    log, counts = import_nuscenes(folder)

    assert (log.name, log.source, log.city) == ("scene-0001", "nuscenes", "singapore-made")
    assert log.track_type.tolist() == [VEHICLE, VEHICLE, PEDESTRIAN]
    np.testing.assert_allclose(log.track_size, [EGO_SIZE, (4.6, 1.9), (0.7, 0.6)], rtol=1e-6)
    assert log.frames == 10 * SECONDS + 1
    t = np.arange(log.frames) * 0.1
    ego, lead, walker = log.track_state.astype(float)
    # The frame begins at the ego's middle; the axle's poses are behind it.
    np.testing.assert_allclose(ego[:, 0], SPEED * t, atol=1e-4)
    np.testing.assert_allclose(lead[:, 0], 30 - EGO_AHEAD + SPEED * t, atol=1e-4)
    np.testing.assert_allclose(lead[:, 3:], [[SPEED, 0.0]] * log.frames, atol=1e-4)
    # 0.1 rad a keyframe, the short way through pi.
    np.testing.assert_allclose(np.diff(walker[:, 2]), 0.02, atol=1e-5)
    assert counts["dropped: track seen once"] == 1
    assert counts["windows"] == log.windows > 5
    write_log(log, tmp_path / "made.npz")
    assert read_log(tmp_path / "made.npz").windows == log.windows


def test_its_map_is_what_lies_near(folder: Path) -> None:
    log, _ = import_nuscenes(folder / "v1.0-mini", scene="scene-0001")

    assert log.lane_intersection.tolist() == [False, False, False, True]  # a, b, c, ab
    assert sorted(log.lane_edges.tolist()) == [[0, 3], [3, 1]]
    assert [len(line) for line in log.polylines("line")] == [2, 2, 2]
    assert log.line_solid.tolist() == [True, False, True]
    assert len(log.polylines("crosswalk")) == 1
    road, hole = sorted(log.polylines("drivable"), key=lambda ring: -np.ptp(ring[:, 0]))
    np.testing.assert_allclose(np.ptp(hole, axis=0), [10.0, 2.0], atol=0.25)
    assert road[:, 1].min() == pytest.approx(-2.0, abs=0.1)


def test_its_windows_can_be_driven(folder: Path) -> None:
    log, _ = import_nuscenes(folder)

    assert set(log.window_ego.tolist()) == {0, 1}
    assert set(log.window_command.tolist()) == {1}
    for window in Scenes(log):
        score = PdmScorer(window).score(human(window)[None])
        assert (score.nc, score.dac) == (1.0, 1.0)


def test_several_scenes_are_told_apart(tmp_path: Path) -> None:
    both = scene_tables("scene-0001")
    for name, rows in scene_tables("scene-0002").items():
        if name in ("scene", "sample", "sample_data", "ego_pose"):
            both[name] = both[name] + rows
    folder = write(tmp_path / "both", both, road())

    log, _ = import_nuscenes(folder, scene="scene-0001")
    with pytest.raises(LogError) as told:
        import_nuscenes(folder)

    assert log.name == "scene-0001"
    assert "expected one of scene-0001, scene-0002, found no name" in str(told.value)


def test_a_track_has_a_gap_where_it_was_hidden(tmp_path: Path) -> None:
    tables = scene_tables()
    hidden = {f"car{k}" for k in (5, 10, 11)}  # gaps of 1.0 and 1.5 s
    rows = tables["sample_annotation"]
    tables["sample_annotation"] = [row for row in rows if row["token"] not in hidden]

    log, counts = import_nuscenes(write(tmp_path / "gap", tables, road()))

    absent = np.flatnonzero(np.isnan(log.track_state[1, :, 0]))
    assert absent.tolist() == list(range(46, 60))
    assert counts["dropped: vehicle off the lanes"] == 1


def change(table: str, key: str, value: object) -> Callable[[Tables, Tables], None]:
    def apply(tables: Tables, expansion: Tables) -> None:
        rows = tables[table] if table in tables else expansion[table]
        if value is None:
            del rows[0][key]
        else:
            rows[0][key] = value

    return apply


@pytest.mark.parametrize(
    ("broken", "file", "field", "found"),
    [
        (change("sample_annotation", "rotation", None), "sample_annotation", "rotation", "none"),
        (change("sample_annotation", "size", [1.0, 2.0]), "sample_annotation", "size", "[2]"),
        (change("sample_annotation", "size", [1.0, 0.0, 1.0]), "annotation", "size", "0.0"),
        (change("sample_annotation", "translation", ["a"] * 3), "annotation", "translation", "<U"),
        (change("sample", "timestamp", float("nan")), "sample.json", "timestamp", "NaN"),
        (change("instance", "category_token", "x"), "instance.json", "category_token", "'x'"),
        (change("category", "name", "flat"), "category.json", "name", "flat"),
        (change("log", "location", "mars"), "mars.json", "file", "No such file"),
        (change("lane", "polygon_token", "x"), "singapore-made", "[a].polygon_token", "'x'"),
        (change("node", "x", None), "singapore-made", "node[n0].x", "none"),
        (change("polygon", "holes", None), "singapore-made", "", ""),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, broken: Callable, file: str, field: str, found: str
) -> None:
    tables, expansion = scene_tables(), road()
    broken(tables, expansion)
    if not field:  # the first polygon is a lane's, which may do without
        del expansion["polygon"][-1]["holes"]
        field, found = "polygon[road].holes", "none"

    with pytest.raises(LogError) as told:
        import_nuscenes(write(tmp_path / "broken", tables, expansion))

    assert file in told.value.path
    assert field in told.value.field
    assert found in str(told.value)


def test_a_missing_table_is_named(folder: Path) -> None:
    (folder / "v1.0-mini" / "ego_pose.json").unlink()

    with pytest.raises(LogError, match=r"ego_pose\.json: file: expected a JSON file"):
        import_nuscenes(folder)


def test_an_arcline_path_turns_by_its_arcs() -> None:
    quarter = 10.0 * np.pi / 2
    path = {
        "start_pose": [1.0, 2.0, 0.0],
        "shape": "LSR",
        "radius": 10.0,
        "segment_length": [quarter, 5.0, quarter],
    }

    points = arc_points(Entry(Path("map.json"), "arc", path))

    np.testing.assert_allclose(points[-1], [1 + 10 + 10, 2 + 10 + 5 + 10], atol=1e-9)
    first = points[1:9]  # on the circle around (1, 12)
    np.testing.assert_allclose(np.hypot(*(first - [1.0, 12.0]).T), 10.0, atol=1e-9)


def test_the_command_knows_the_layout(tmp_path: Path, folder: Path) -> None:
    out = tmp_path / "made.npz"

    with pytest.raises(SystemExit) as ended:
        main(["data", "import-log", str(folder), "--out", str(out)])

    assert not ended.value.code
    assert read_log(out).windows > 5
