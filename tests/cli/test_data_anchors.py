"""`anchorflow data anchors` clusters and scores; what it does is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import failure, succeed
from driven_bend import write_bends

from anchorflow_cli import data_driving
from anchorflow_training.driving.sensor_windows import SensorSizes, SensorWindows


def test_anchors_are_written_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs, out = write_bends(tmp_path, count=1), tmp_path / "made" / "anchors.txt"
    succeed("data", "anchors", logs, "--out", out, "--count", 3)
    assert np.load(out).shape == (3, 8, 3)
    assert "3 anchors of 3 windows" in capsys.readouterr().out
    (kept,) = logs.glob("*.pdm-*")
    assert np.load(kept)["scores"].shape == (3, 3, 5)


def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    logs, out = write_bends(tmp_path, count=1), tmp_path / "anchors.npy"
    out.symlink_to("/dev/full")
    said = failure("data", "anchors", logs, "--out", out, "--count", 3)
    assert f"anchorflow data: {out}: expected a place to write" in said


def test_sensors_are_drawn_for_any_planner_that_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    logs, config = write_bends(tmp_path, count=1), tmp_path / "run.yaml"
    config.write_text("planner: diffusiondrive\nmodel: {backbone: {image_height: 64}}\n")
    heights = []

    def opened(_logs: object, sizes: SensorSizes, **_: object) -> SensorWindows:
        heights.append(sizes.camera_rows)
        return SensorWindows([b"1"], {}, np.zeros(1, np.int64), [], sizes)

    monkeypatch.setattr(data_driving, "open_sensor_windows", opened)
    succeed("data", "sensors", logs, "--config", config)
    assert (heights, "1 windows" in capsys.readouterr().out) == ([64], True)


def test_sensors_for_a_planner_without_any_are_refused(tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text("planner: flowmp\n")
    said = failure("data", "sensors", tmp_path, "--config", config)
    assert "planner: expected one that sees by camera and LiDAR, got 'flowmp'" in said
