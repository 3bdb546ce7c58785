"""Argoverse 2 scenarios made here: two lanes straight on, an ego behind another car."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pyarrow = pytest.importorskip("pyarrow", reason="pyarrow reads parquet: pip install pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

from anchorflow_cli.main import main  # noqa: E402 - after what it may lack
from anchorflow_driving.drivers import human  # noqa: E402
from anchorflow_driving.errors import LogError  # noqa: E402
from anchorflow_driving.importers.argoverse import (  # noqa: E402
    EGO_SIZE,
    KINDS,
    import_argoverse,
)
from anchorflow_driving.log import PEDESTRIAN, VEHICLE, read_log, write_log  # noqa: E402
from anchorflow_driving.pdm import PdmScorer  # noqa: E402
from anchorflow_driving.window import Scenes  # noqa: E402

FRAMES, SPEED = 110, 8.0
CORNER = np.array([6000.0, -1400.0])
NAME = "0a0a-made"


def rows(track: str, kind: str, frames: range, x: float, y: float, speed: float) -> list[dict]:
    return [
        {
            "track_id": track,
            "object_type": kind,
            "timestep": frame,
            "position_x": CORNER[0] + x + speed * 0.1 * frame,
            "position_y": CORNER[1] + y,
            "heading": 0.0,
            "velocity_x": speed,
            "velocity_y": 0.0,
            "scenario_id": NAME,
            "city": "austin",
        }
        for frame in frames
    ]


def tracks() -> list[dict]:
    return [
        *rows("7", "vehicle", range(FRAMES), 30.0, 0.0, SPEED),
        *rows("AV", "vehicle", range(FRAMES), 0.0, 0.0, SPEED),
        *rows("9", "pedestrian", range(40, 60), 60.0, -4.0, 0.0),
    ]


def line(x0: float, y0: float, x1: float, y1: float) -> list[dict]:
    return [{"x": CORNER[0] + x, "y": CORNER[1] + y, "z": 0.0} for x, y in ((x0, y0), (x1, y1))]


def lane(name: int, x0: float, x1: float, y: float, **changed: Any) -> dict:
    return {
        "id": name,
        "is_intersection": False,
        "lane_type": "VEHICLE",
        "left_lane_boundary": line(x0, y + 2, x1, y + 2),
        "left_lane_mark_type": "DASHED_WHITE",
        "right_lane_boundary": line(x0, y - 2, x1, y - 2),
        "right_lane_mark_type": "NONE",
        "successors": [],
        **changed,
    }


def archive() -> dict[str, dict]:
    lanes = [
        lane(1, -50, 80, 0, successors=[2]),
        lane(2, 80, 250, 0, is_intersection=True, right_lane_mark_type="SOLID_WHITE"),
        lane(3, -50, 250, 4),
        lane(4, -50, 250, -3, lane_type="BIKE"),
    ]
    area = [*line(-50, -2, 250, -2), *line(250, 6, -50, 6)]
    crossing = {"id": 5, "edge1": line(120, -2, 120, 6), "edge2": line(124, -2, 124, 6)}
    return {
        "lane_segments": {str(each["id"]): each for each in lanes},
        "drivable_areas": {"8": {"id": 8, "area_boundary": area}},
        "pedestrian_crossings": {"5": crossing},
    }


def write(folder: Path, states: list[dict], road: dict) -> Path:
    folder.mkdir()
    parquet.write_table(pyarrow.Table.from_pylist(states), folder / f"scenario_{NAME}.parquet")
    (folder / f"log_map_archive_{NAME}.json").write_text(json.dumps(road))
    return folder


def test_a_scenario_becomes_a_log(tmp_path: Path) -> None:
    log, counts = import_argoverse(write(tmp_path / "one", tracks(), archive()))

    assert (log.name, log.source, log.city) == (NAME, "av2", "austin")
    assert log.track_type.tolist() == [VEHICLE, VEHICLE, PEDESTRIAN]
    sizes = [EGO_SIZE, KINDS["vehicle"][1], KINDS["pedestrian"][1]]
    np.testing.assert_allclose(log.track_size, sizes, rtol=1e-6)
    assert log.frames == FRAMES
    t = np.arange(FRAMES) * 0.1
    np.testing.assert_allclose(log.track_state[0, :, 0], SPEED * t, atol=1e-4)
    np.testing.assert_allclose(log.track_state[1, :, 0], 30 + SPEED * t, atol=1e-4)
    assert np.flatnonzero(np.isfinite(log.track_state[2, :, 0])).tolist() == list(range(40, 60))
    assert log.lane_edges.tolist() == [[0, 1]]
    assert log.lane_intersection.tolist() == [False, True, False]
    assert sorted(log.line_solid.tolist()) == [False, False, False, False, True]
    np.testing.assert_allclose(log.polylines("centre")[2][:, 1], 4.0, atol=1e-4)
    np.testing.assert_allclose(np.ptp(log.polylines("crosswalk")[0], axis=0), [4.0, 8.0])
    assert counts["windows"] == log.windows == 2 * 5
    write_log(log, tmp_path / "made.npz")
    assert read_log(tmp_path / "made.npz").windows == log.windows


def test_its_windows_can_be_driven(tmp_path: Path) -> None:
    folder = write(tmp_path / "one", tracks(), archive())

    log, _ = import_argoverse(folder / f"scenario_{NAME}.parquet")

    for window in Scenes(log):
        score = PdmScorer(window).score(human(window)[None])
        assert (score.nc, score.dac) == (1.0, 1.0)


def test_the_order_of_rows_does_not_matter(tmp_path: Path) -> None:
    log, _ = import_argoverse(write(tmp_path / "one", tracks(), archive()))
    other, _ = import_argoverse(write(tmp_path / "two", tracks()[::-1], archive()))

    np.testing.assert_array_equal(other.track_state, log.track_state)


def without(column: str) -> Callable[[list[dict], dict], list[dict]]:
    return lambda states, _: [
        {name: value for name, value in state.items() if name != column} for state in states
    ]


def with_value(column: str, value: object) -> Callable[[list[dict], dict], list[dict]]:
    return lambda states, _: [states[0] | {column: value}, *states[1:]]


def with_lane(key: str, value: object) -> Callable[[list[dict], dict], list[dict]]:
    def apply(states: list[dict], road: dict) -> list[dict]:
        road["lane_segments"]["1"][key] = value
        return states

    return apply


@pytest.mark.parametrize(
    ("broken", "file", "field", "found"),
    [
        (without("heading"), "scenario_", "heading", "none"),
        (with_value("velocity_x", float("nan")), "scenario_", "velocity_x", "double"),
        (with_value("position_y", None), "scenario_", "position_y", "double"),
        (with_value("object_type", "boat"), "scenario_", "object_type of track 7", "boat"),
        (with_value("timestep", 1), "scenario_", "timestep of track 7", "[1.0, 1.0"),
        (lambda states, _: states[:FRAMES], "scenario_", "track_id", "none"),
        (lambda _, __: [], "scenario_", "scenario_id", "none"),
        (with_lane("successors", None), "log_map", "lane_segments.1.successors", "none"),
        (with_lane("is_intersection", 1), "log_map", "lane_segments.1.is_intersection", "int"),
        (with_lane("left_lane_boundary", [{"x": 1.0}]), "log_map", "left_lane_boundary[0].y", ""),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, broken: Callable, file: str, field: str, found: str
) -> None:
    road = archive()
    folder = write(tmp_path / "broken", broken(tracks(), road), road)

    with pytest.raises(LogError) as told:
        import_argoverse(folder)

    assert file in told.value.path
    assert told.value.field.endswith(field)
    assert found in str(told.value)


def test_a_missing_map_and_a_broken_parquet_are_named(tmp_path: Path) -> None:
    folder = write(tmp_path / "one", tracks(), archive())
    (folder / f"scenario_{NAME}.parquet").write_bytes(b"PAR1")
    with pytest.raises(LogError, match=r"made\.parquet: file: expected a parquet file"):
        import_argoverse(folder)

    (folder / f"log_map_archive_{NAME}.json").unlink()
    write(tmp_path / "two", tracks(), archive())
    (tmp_path / "two" / f"log_map_archive_{NAME}.json").unlink()
    with pytest.raises(LogError, match=r"expected one log_map_archive_\*\.json, found none"):
        import_argoverse(tmp_path / "two")


def test_the_command_knows_the_layout(tmp_path: Path) -> None:
    folder = write(tmp_path / "one", tracks(), archive())
    out = tmp_path / "made.npz"

    with pytest.raises(SystemExit) as ended:
        main(["data", "import-log", str(folder), "--out", str(out)])

    assert not ended.value.code
    assert read_log(out).windows > 5
