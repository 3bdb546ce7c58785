"""`anchorflow data frames`, on a bend that is made here."""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import failure, succeed
from driven_bend import SIZE, bend
from image_planner import write_image_bundle

from anchorflow_client.sensors import route_ahead
from anchorflow_driving.drive_file import windows_on_the_way
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.geometry import into_frame, out_of_frame
from anchorflow_driving.log import COMMANDS, write_log
from anchorflow_driving.sensors.bev import draw_bev
from anchorflow_driving.sensors.inputs import status_of
from anchorflow_driving.sensors.others import others_seen
from anchorflow_driving.window import Scenes
from anchorflow_service.bundle import DEFAULT_BUNDLE

GOALFLOW = DEFAULT_BUNDLE.parent / "goalflow"


def command(tmp_path: Path, *options: str, bundle: Path = GOALFLOW) -> tuple[object, ...]:
    """Return the words of the command for a log that is written here."""
    log, out = tmp_path / "bend.npz", tmp_path / "drive.json"
    write_log(bend(0), log)
    return ("data", "frames", log, "--bundle", bundle, "--out", out, *options)


def drawn(tmp_path: Path, *options: str) -> dict[str, Any]:
    succeed(*command(tmp_path, *options))
    return json.loads((tmp_path / "drive.json").read_text())


def unpacked(value: dict[str, Any]) -> np.ndarray:
    data = zlib.decompress(base64.b64decode(value["zlib"]))
    return np.frombuffer(data, value["dtype"]).reshape(value["shape"])


def test_every_frame_holds_what_the_card_asks_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = drawn(tmp_path, "--every", "0.4")

    assert "7 frames of track 0, 2 to 4.4 s" in capsys.readouterr().out
    head = {"format": "anchorflow-drive", "version": 1, "bundle": "goalflow"}
    assert {name: drive[name] for name in head} == head
    names = [each["name"] for each in drive["inputs"]]
    assert names == ["bev", "ego_status", "vehicle_size", "route", "others"]
    windows = [*Scenes(windows_on_the_way(bend(0), every_s=0.4))]
    assert len(windows) == len(drive["frames"]) == 7
    for window, frame in zip(windows, drive["frames"], strict=True):
        inputs = frame["inputs"]
        assert frame["time_s"] == pytest.approx(window.frame / 10)
        np.testing.assert_array_equal(unpacked(inputs["bev"]), draw_bev(window.view))
        np.testing.assert_array_equal(np.float32(inputs["ego_status"]), status_of(window.view))
        np.testing.assert_array_equal(
            np.float32(inputs["vehicle_size"]), np.array(SIZE, np.float32)
        )
        route = route_ahead(window.view.route.points)
        np.testing.assert_allclose(unpacked(inputs["route"]), route, rtol=1e-5, atol=1e-3)
        np.testing.assert_array_equal(unpacked(inputs["others"]), others_seen(window.view))
        np.testing.assert_allclose(frame["recorded"], window.recorded(PLAN_TIMES), atol=1e-3)


def test_street_and_others_lie_around_the_ego(tmp_path: Path) -> None:
    drive = drawn(tmp_path)
    log = windows_on_the_way(bend(0))
    first, last = Scenes(log)[0].state.pose, Scenes(log)[log.windows - 1].state.pose

    assert drive["frames"][0]["pose"] == [0, 0, 0]
    ring = np.reshape(drive["map"]["drivable"], (-1, 2))
    expected = into_frame(log.polylines("drivable")[0], first)
    np.testing.assert_allclose(ring, expected, atol=0.011)
    frame = drive["frames"][-1]
    np.testing.assert_allclose(out_of_frame(np.array(frame["pose"]), first), last, atol=1e-3)
    ((x, y, heading, length, width, kind),) = frame["boxes"]
    leader = log.track_state[1, log.window_frame[-1], :3].astype(np.float64)
    np.testing.assert_allclose([x, y, heading], into_frame(leader, last), atol=0.011)
    assert (length, width, kind) == (*SIZE, 0)


def test_a_way_is_asked_about_from_first_to_last() -> None:
    log = bend(0)
    scattered = replace(
        log,
        window_ego=log.window_ego[1:2],
        window_frame=log.window_frame[1:2],
        window_command=log.window_command[1:2],
        window_speed_limit=log.window_speed_limit[1:2],
        route_points=log.route(1).astype(np.float32),
        route_offsets=np.array([0, len(log.route(1))], np.int32),
    )

    way = windows_on_the_way(scattered, every_s=0.5)

    # 20 frames before and 45 after are recorded, and frame 30 is asked about.
    assert way.window_frame.tolist() == [20, 25, 30, 35, 40]
    # 46 m along a bend of 50 m: the left.
    assert {COMMANDS[command] for command in way.window_command} == {"left"}
    np.testing.assert_allclose(way.route(4), scattered.route(0))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--track", "1"), "track: expected one of 0, got 1"),
        (("--every", "0.25"), "every: expected a multiple of 0.1 s, got 0.25 s"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, options: tuple[str, ...], told: str) -> None:
    assert told in failure(*command(tmp_path, *options))
    assert not (tmp_path / "drive.json").exists()


def test_a_card_that_asks_for_another_sensor_is_refused(tmp_path: Path) -> None:
    bundle = write_image_bundle(tmp_path)
    manifest = json.loads((bundle / "manifest.json").read_text())
    manifest["request"]["inputs"] = manifest["request"]["inputs"][::-1]
    (bundle / "manifest.json").write_text(json.dumps(manifest))

    said = failure(*command(tmp_path, bundle=bundle))
    assert "ego_status: expected a sensor of [4], got [8]" in said
