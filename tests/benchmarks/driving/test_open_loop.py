"""Drivers on a small log, judged, and the command that does it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import succeed
from driven_bend import MADE, one_lane

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.driving.open_loop import drive_tables, judge_drivers, named_drivers
from anchorflow_driving.log import VEHICLE, DrivingLog, track_fields, window_fields, write_log
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle

FRAMES, NOW = 80, 20


@pytest.fixture
def log() -> DrivingLog:
    """Two vehicles that pass each other on an empty square at 10 and 5 m/s: a window each."""
    x = np.outer([10.0, -5.0], (np.arange(FRAMES) - NOW) * 0.1)
    state = np.zeros((2, FRAMES, 5), np.float32)
    state[..., 0], state[1, :, 1], state[1, :, 2] = x, 10.0, np.pi
    state[..., 3] = [[10.0], [-5.0]]
    square = 150.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    routes = [np.array([[-100.0, 0.0], [100.0, 0.0]]), np.array([[100.0, 10.0], [-100.0, 10.0]])]
    return DrivingLog(
        name="square",
        **MADE,
        **track_fields([VEHICLE] * 2, [(5.0, 2.0)] * 2, state),
        **one_lane(square, square[:2]),
        **window_fields([0, 1], [NOW] * 2, [1, 2], [10.0, 5.0], routes),
    )


def test_tables_tell_windows_apart_by_source_command_and_log(log: DrivingLog) -> None:
    judged = judge_drivers(named_drivers(["human", "stop", "idm_40_poses"]), [log])

    tables = {table.title: table.rows for table in drive_tables(judged)}

    assert list(tables) == [
        "All windows (2)",
        "Source made (2)",
        "Command straight (1)",
        "Command right (1)",
        "PDMS by log",
    ]
    human, stop, idm = tables["All windows (2)"]
    assert human["PDMS"] == pytest.approx(1.0)
    assert (human["ADE"], human["FDE"], human["hit"]) == (0, 0, 0)
    assert idm["PDMS"] == pytest.approx(1.0)
    assert str(idm["hit"]) == "nan"
    # A vehicle braking at 3 m/s² stops v²/6 after the start, while the record goes on.
    assert stop["FDE"] == pytest.approx(np.mean([40 - 100 / 6, 20 - 25 / 6]), abs=1e-3)
    assert stop["L2 1 s"] == pytest.approx(1.5, abs=1e-3)
    (right,) = [row for row in tables["Command right (1)"] if row["driver"] == "stop"]
    assert right["FDE"] == pytest.approx(20 - 25 / 6, abs=1e-3)
    assert tables["PDMS by log"][0]["windows"] == 2


def test_an_unknown_driver_is_named() -> None:
    with pytest.raises(BenchmarkError, match=r"among human, idm, .*, got 'chauffeur'"):
        named_drivers(["human", "chauffeur"])


def test_the_command_writes_tables_plans_and_its_record(
    log: DrivingLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs, out, bundle = (tmp_path / name for name in ("logs", "out", "goalflow"))
    logs.mkdir()
    write_log(log, logs / "by-file-name.npz")
    shutil.copytree(DEFAULT_BUNDLE.parent / "goalflow", bundle)
    options = ("--bundle", str(bundle), "--along-route", "--seed", "3", "--record")

    succeed("bench", "drive", "--logs", logs, *options, "--out", out)

    assert "route_constant_speed" in capsys.readouterr().out
    report = json.loads((out / "drive.json").read_text())
    assert report["about"]["logs"] == "logs: 1 files, 2 windows"
    rules = ("human", "stop", "constant_velocity", "route_constant_speed")
    bundles = ("goalflow_seed3", "goalflow_along_route_seed3")
    assert {path.name for path in out.iterdir()} == {
        "drive.json",
        "drive.md",
        *(f"plans_{name}.npz" for name in (*rules, "idm", *bundles)),
        *(f"waypoints_{name}.npz" for name in rules),
    }
    with np.load(out / "plans_human.npz") as plans:
        assert plans["log"].tolist() == ["by-file-name"] * 2
        assert plans["window"].tolist() == [0, 1]
        assert plans["trajectories"].shape == (2, 8, 3)
    with np.load(out / "waypoints_stop.npz") as waypoints:
        assert waypoints["trajectories"].shape == (2, 45, 2)
    (row,) = (row for row in report["tables"][0]["rows"] if row["driver"] == "goalflow_seed3")
    quality = load_bundle(bundle).card.quality
    assert quality["logs"] == "logs: 1 files, 2 windows"
    assert quality["PDMS"] == pytest.approx(row["PDMS"], abs=1e-4)
    assert not {"driver", "ms"} & quality.keys()
