"""Whole simulated logs: what they hold, and that only the seed decides it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anchorflow_driving.drivers import human
from anchorflow_driving.errors import LogError
from anchorflow_driving.log import FUTURE_FRAMES, STATIC, DrivingLog, read_logs
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.road import Road
from anchorflow_driving.simulation import LogConfig
from anchorflow_driving.window import Scenes

CONFIG = LogConfig(seed=3, seconds=12.0, windows=12)


def made(folder: Path, *, logs: int, config: LogConfig = CONFIG) -> Path:
    for module in ("sumo", "libsumo"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    from anchorflow_driving.simulation.make_logs import make_logs

    make_logs(folder, config, logs=logs, workers=logs)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("drive"), logs=2)


@pytest.fixture(scope="module")
def logs(folder: Path) -> list[DrivingLog]:
    return read_logs(folder)


def test_a_folder_holds_the_logs_of_one_run_which_depend_on_seed_and_index_alone(
    folder: Path, tmp_path: Path
) -> None:
    kept = shutil.copytree(folder, tmp_path / "kept")
    first, second = sorted(path.name for path in folder.glob("*.npz"))

    with pytest.raises(LogError, match=f"a new one, or .* the same seed .*, found {second}$"):
        made(kept, logs=1)
    with pytest.raises(LogError, match=f"found {first} and 1 more"):
        made(kept, logs=2, config=replace(CONFIG, seed=4))

    for name in (first, second):
        (kept / name).unlink()
    made(kept, logs=1)
    assert json.loads((kept / "drive.json").read_text())["logs"] == 1
    assert (kept / first).read_bytes() == (folder / first).read_bytes()
    assert (folder / first).read_bytes() != (folder / second).read_bytes()


def test_the_summary_counts_the_logs_windows(folder: Path, logs: list[DrivingLog]) -> None:
    summary = json.loads((folder / "drive.json").read_text())

    assert summary["windows"] == sum(log.windows for log in logs) > 0
    commands = np.concatenate([log.window_command for log in logs])
    assert list(summary["commands"].values()) == np.bincount(commands, minlength=3).tolist()
    turned = sum(
        abs(track[frame + FUTURE_FRAMES, 2] - track[frame, 2]) > np.deg2rad(20)
        for log in logs
        for ego, frame in zip(log.window_ego, log.window_frame, strict=True)
        for track in [log.track_state[ego]]
    )
    assert summary["turning"] == turned
    assert turned / summary["windows"] == pytest.approx(1 / 3, abs=0.1)


def test_its_drivers_keep_the_rules_that_planners_are_judged_by(logs: list[DrivingLog]) -> None:
    scores = [
        PdmScorer(window).score(human(window)[None]) for log in logs for window in Scenes(log)
    ]

    assert np.mean([score.nc for score in scores]) > 0.9
    assert np.mean([score.dac for score in scores]) > 0.9
    assert np.mean([score.c for score in scores]) > 0.9
    assert all(log.source == "simulated" for log in logs)


def test_static_objects_stand_where_nobody_drives(logs: list[DrivingLog]) -> None:
    counts = []
    for log in logs:
        static = log.track_state[log.track_type == STATIC]
        counts.append(len(static))
        assert (static[:, :, :3] == static[:, :1, :3]).all()
        assert not static[..., 3:].any()
        assert not Road(log).in_lanes(static[:, 0, :2].astype(float)).any()
    assert min(counts) > 0


def test_speed_limits_may_be_unknown(logs: list[DrivingLog]) -> None:
    from anchorflow_driving.simulation.simulated_log import simulate_log

    assert np.isfinite(logs[0].window_speed_limit).all()
    log, _ = simulate_log(replace(CONFIG, speed_limits=False), 0)
    assert np.isnan(log.window_speed_limit).all()
    np.testing.assert_array_equal(log.window_frame, logs[0].window_frame)


def test_the_route_leads_along_what_was_driven(logs: list[DrivingLog]) -> None:
    for log in logs:
        for window in Scenes(log):
            driven = window.recorded(np.arange(0, 46) / 10)
            _, aside = window.view.route.project(driven[:, :2])
            assert np.abs(aside).max() < 2.5


@pytest.mark.parametrize("most", [1, 5])
def test_a_log_has_no_more_windows_than_are_asked_for(most: int) -> None:
    pytest.importorskip("libsumo", reason="libsumo is not installed")
    from anchorflow_driving.simulation.simulated_log import simulate_log

    log, _ = simulate_log(replace(CONFIG, windows=most), 0)
    assert log.windows == most
