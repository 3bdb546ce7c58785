"""What nuScenes alone has: keyframes with gaps, poses of a rear axle, and a map of arcs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_nuscenes import SPEED, recording, write

from anchorflow_driving.importers.fields import Entry
from anchorflow_driving.importers.nuscenes import EGO_AHEAD, import_nuscenes
from anchorflow_driving.importers.nuscenes_map import arc_points


def test_tracks_are_those_of_the_boxes_middles(tmp_path: Path) -> None:
    log, counts = import_nuscenes(write(tmp_path, recording()))

    assert set(log.window_command.tolist()) == {1}
    t = np.arange(log.frames) * 0.1
    ego, lead, walker = log.track_state.astype(float)
    # The frame begins at the ego's middle; the axle's poses are behind it.
    np.testing.assert_allclose(ego[:, 0], SPEED * t, atol=1e-4)
    np.testing.assert_allclose(lead[:, 0], 30 - EGO_AHEAD + SPEED * t, atol=1e-4)
    np.testing.assert_allclose(lead[:, 3:], [[SPEED, 0.0]] * log.frames, atol=1e-4)
    # 0.1 rad a keyframe, the short way through pi.
    np.testing.assert_allclose(np.diff(walker[:, 2]), 0.02, atol=1e-5)
    assert counts["dropped: track seen once"] == 1
    assert log.frame_token is not None
    told = [row["token"] for row in recording()["tables"]["sample"]]
    assert log.frame_token[::5].tolist() == told  # of 2 Hz
    assert set(np.delete(log.frame_token, np.s_[::5])) == {""}


def test_its_map_is_what_lies_near(tmp_path: Path) -> None:
    folder = write(tmp_path, recording())

    log, _ = import_nuscenes(folder / "v1.0-mini", scene="scene-0001")

    assert [len(line) for line in log.polylines("line")] == [2, 2, 2]
    assert log.line_solid.tolist() == [True, False, True]
    assert len(log.polylines("crosswalk")) == 1
    road, hole = sorted(log.polylines("drivable"), key=lambda ring: -np.ptp(ring[:, 0]))
    np.testing.assert_allclose(np.ptp(hole, axis=0), [10.0, 2.0], atol=0.25)
    assert road[:, 1].min() == pytest.approx(-2.0, abs=0.1)


def test_a_track_has_a_gap_where_it_was_hidden(tmp_path: Path) -> None:
    made = recording()
    hidden = {f"car{k}" for k in (5, 10, 11)}  # gaps of 1.0 and 1.5 s
    rows = made["tables"]["sample_annotation"]
    made["tables"]["sample_annotation"] = [row for row in rows if row["token"] not in hidden]

    log, counts = import_nuscenes(write(tmp_path, made))

    absent = np.flatnonzero(np.isnan(log.track_state[1, :, 0]))
    assert absent.tolist() == list(range(46, 60))
    assert counts["dropped: vehicle off the lanes"] == 1


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
