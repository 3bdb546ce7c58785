"""Bundles that drive, judged with their proposals."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import failure
from driven_bend import bend, write_bends
from image_planner import write_image_bundle

from anchorflow_benchmarks.driving.open_loop import (
    Entry,
    drive_tables,
    judge_drivers,
    open_drivers,
    proposal_figures,
    ways_to_drive,
    write_plans,
)
from anchorflow_driving import bundle_driver
from anchorflow_driving.bundle_driver import BundleDriver, WindowProposals
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.errors import SensorError
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.sensors.inputs import SENSORS
from anchorflow_driving.window import Scenes
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle

GOALFLOW = DEFAULT_BUNDLE.parent / "goalflow"
N = 16


def opened(folder: Path = GOALFLOW, *, num: int = N, sampler: str = "card") -> BundleDriver:
    (driver,) = open_drivers([folder], num=num, samplers=[sampler], threads=1)
    return driver


def test_a_bundle_is_judged_with_its_proposals(tmp_path: Path) -> None:
    driver = opened(sampler="euler:uniform2")
    judged = judge_drivers({driver.name: Entry(driver)}, [bend(0)])

    tables = {table.title: table.rows for table in drive_tables(judged)}
    (row,) = tables["Proposals"]
    assert row["driver"] == "goalflow_euler_uniform2"
    assert row["N"] == N
    assert float(str(row["PDMS"])) <= float(str(row["oracle"])) <= 1.0
    (goals,) = tables["Goals"]
    assert 0.0 <= float(str(goals["off-road score"])) < 0.5

    (path,) = write_plans(judged, tmp_path)
    with np.load(path) as plans:
        windows = len(plans["window"])
        assert plans["proposals"].shape == (windows, N, 8, 3)
        best = plans["scores"].argmax(1)
        chosen = plans["proposals"][np.arange(windows), best]
        np.testing.assert_array_equal(plans["trajectories"], chosen)


def test_a_driver_that_foresees_is_told_of_the_others_and_keeps_the_better_proposals() -> None:
    driver = opened()
    assert driver.predicts
    foreseeing, window = driver.foreseeing(), Scenes(bend(0))[0]
    assert foreseeing.name == "goalflow_foreseeing"
    plain, foreseen = driver.propose(window), foreseeing.propose(window)
    assert plain.scores is not None
    assert foreseen.scores is not None
    same = (plain.trajectories == foreseen.trajectories).all((1, 2))
    assert 3 * N // 4 <= same.sum() < N
    # The leader drives on along the bend, and not into the field beside it.
    assert np.abs(plain.scores - foreseen.scores).max() > 1e-4


def test_foreseeing_without_a_bundle_that_predicts_is_refused(tmp_path: Path) -> None:
    logs = ("--logs", write_bends(tmp_path, count=1), "--drivers", "stop")
    said = failure("bench", "drive", *logs, "--foreseeing", "--out", tmp_path)
    assert "--foreseeing: expected a --bundle whose card has futures" in said


def test_other_seeds_draw_other_proposals() -> None:
    window = Scenes(bend(0))[0]
    zero, one = (opened().seeded(seed) for seed in (0, 1))

    assert (zero.name, one.name) == ("goalflow", "goalflow_seed1")
    assert not np.array_equal(zero.propose(window).trajectories, one.propose(window).trajectories)


def test_who_takes_a_route_is_told_it_and_others_are_chosen_by_it() -> None:
    window = Scenes(bend(0))[0]
    driver = opened()
    told = driver.along_route()
    assert told.name == "goalflow_along_route"
    alone, along = driver.propose(window), told.propose(window)
    assert alone.scores is not None
    assert along.scores is not None
    assert (alone.best, along.best) == (alone.scores.argmax(), along.scores.argmax())
    _, strays = window.view.route.project(along.trajectories[:, -1, :2])
    assert (np.abs(strays) < 0.5).sum() > (
        np.abs(window.view.route.project(alone.trajectories[:, -1, :2])[1]) < 0.5
    ).sum()
    np.testing.assert_array_equal(told(window), along.trajectories[along.best])


def test_planners_that_have_route_drives_drive_with_them() -> None:
    folders = [DEFAULT_BUNDLE.parent / name for name in ("goalflow", "wote")]
    ours = open_drivers(folders, num=64, threads=1)
    ways = ways_to_drive(ours, along_route=False, foreseeing=False, route_drives=True)
    assert [way.name for way in ways] == ["goalflow", "wote", "wote_route_drives"]
    window = Scenes(bend(0))[0]
    alone, among = (way.propose(window) for way in ways[1:])
    own = {way.tobytes() for way in alone.trajectories}
    assert 8 < sum(way.tobytes() not in own for way in among.trajectories) < 64


def test_who_draws_no_noise_has_one_name_for_all_seeds() -> None:
    driver = opened(GOALFLOW.parent / "wote")
    assert driver.seeded(1) is driver


def test_who_chooses_among_fewer_proposes_all_of_them() -> None:
    bundle = DEFAULT_BUNDLE.parent / "diffusiondrive"
    most = load_bundle(bundle).card.sampler.size  # type: ignore[union-attr]
    driver = opened(bundle, num=most + 1)
    window = Scenes(bend(0))[0]
    shapes = {"camera": (3, 128, 512), "lidar": (1, 256, 256), "ego_status": (8,)}
    types = {"camera": np.uint8}
    drawn = {name: np.zeros(shape, types.get(name, np.float32)) for name, shape in shapes.items()}
    drawn["ego_status"][1] = 1.0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bundle_driver, "draw_inputs", lambda *_: drawn)
        proposals = driver.propose(window)
    assert len(proposals.trajectories) == most


def test_figures_of_known_proposals() -> None:
    window = Scenes(bend(0))[0]
    driven = window.recorded(PLAN_TIMES)
    away = np.add(driven, (0.0, 2.5, 0.0))
    end = driven[-1, :2]
    proposals = WindowProposals(
        trajectories=np.stack([away, driven]),
        scores=np.array([0.2, 0.9]),
        goals=np.stack([*[end + 50.0] * 5, end]),
        goal_scores=np.array([0.5, 0.4, 0.3, 0.2, 0.1, 0.9]),
        best=1,
        drawing_ms=1.0,
        flow_ms=1.0,
    )
    figures = proposal_figures(window, proposals, PdmScorer(window))

    assert figures["minADE"] == pytest.approx(0.0)
    assert figures["oracle"] == pytest.approx(1.0, abs=0.1)
    assert figures["rank"] == pytest.approx(1.0)
    assert (figures["top 5"], figures["top 5 by score"]) == (0.0, 1.0)
    assert figures["off-road score"] == pytest.approx(np.mean([0.5, 0.4, 0.3, 0.2, 0.1]))


def test_a_bundle_without_windows_has_no_table() -> None:
    titles = [table.title for table in drive_tables({"wote": []})]

    assert titles == ["All windows (0)", "PDMS by log"]


def test_a_bundle_that_asks_for_more_than_a_log_tells_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = {name: sensor for name, sensor in SENSORS.items() if name != "camera"}
    monkeypatch.setattr("anchorflow_driving.sensors.inputs.SENSORS", known)
    with pytest.raises(SensorError, match=r"expected inputs among bev, .* got camera"):
        opened(write_image_bundle(tmp_path))


def test_bundles_of_one_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    copy = shutil.copytree(GOALFLOW, tmp_path / "another")

    drivers = open_drivers([GOALFLOW, copy], num=N, threads=1)

    assert [driver.name for driver in drivers] == ["goalflow_goalflow", "goalflow_another"]
