"""A contest and its command: worlds and contenders over worker processes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command_line import failure, succeed

from anchorflow_benchmarks.closed_loop.anchor_sources import RoutesSource
from anchorflow_benchmarks.closed_loop.contest import (
    Contender,
    ContestConfig,
    Heat,
    run_contest,
    run_heat,
)
from anchorflow_benchmarks.closed_loop.drive import DriveConfig
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig
from anchorflow_benchmarks.closed_loop.worlds import World
from anchorflow_client import AnchorRequest
from anchorflow_client.contract import CostMap, RefineChoice
from anchorflow_control import MppiConfig as ControlConfig
from anchorflow_export.bundle import record_quality
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle

ALONE = Contender("MPPI", None, 48, "anchorflow")
LINES = Contender("lines", "lines", 48)
ROUTES = Contender("routes", "routes", 48)
SERVED = Contender("served", "served", 48)
OWN = Contender("own", "served", 48, "anchorflow")
CONFIG = ContestConfig(
    bundle=DEFAULT_BUNDLE,
    threads=1,
    latency_ms=60.0,
    mppi=MppiConfig(steps=15),
    control=ControlConfig(steps=15),
    drive=DriveConfig(
        limit_s=0.5,
        map_cells=64,
        map_resolution=0.1,
        options={"num_samples": 8, "sampler": {"method": "euler", "schedule": {"uniform": 1}}},
    ),
)


def test_every_contender_runs_with_every_seed_in_whichever_process(
    world: Callable[..., World],
) -> None:
    worlds = [world([(3.0, 0.0)], name="one", path_length=7.0)]
    done: list[int] = []
    results = run_contest([ALONE, LINES], worlds, CONFIG, seeds=2, workers=2, progress=done.append)

    assert [(r.world, r.seed, r.contender) for r in results] == [
        ("one", seed, contender) for seed in (0, 1) for contender in ("MPPI", "lines")
    ]
    assert done == [1] * 4
    assert results[-1].path_length == 7.0
    assert run_heat(Heat(LINES, worlds[0], 1), CONFIG).run == results[-1].run


@pytest.mark.parametrize("contender", [SERVED, ROUTES, OWN])
def test_anchors_arrive_as_late_as_they_take(
    contender: Contender, world: Callable[..., World]
) -> None:
    result = run_heat(Heat(contender, world([(3.0, 0.0)]), 0), CONFIG)

    assert result.run.length > 0.1
    assert result.run.ticks_braked == 1  # until the first answer
    np.testing.assert_allclose(result.latencies_ms, 60.0)
    assert len(result.latencies_ms) >= 2


def test_routes_pass_an_obstacle_on_both_sides() -> None:
    bundle = load_bundle(DEFAULT_BUNDLE)
    occupied = np.zeros((64, 64), np.float32)
    occupied[26:38, 30:34] = 1.0  # 6.4 m a side, in the middle of the way
    cost_map = CostMap.build(occupied[None], 0.1, [-3.2, -3.2])
    request = AnchorRequest.build(
        cost_map=cost_map, x_curr=[-2, 0, 0, 0, 0, 0], x_goal=[2, 0, 0, 0], num_samples=8, seed=1
    )
    batch = RoutesSource(bundle).plan_request(request)
    middle = batch.trajectories[:, 32, 1]
    too_much = RoutesSource(bundle).plan_request(
        replace(request, refine=RefineChoice(certified_margin=5.0))
    )

    assert batch.trajectories.shape[0] == 8
    assert batch.safe.all()
    assert not too_much.safe.any()  # the margin is the routes' too
    assert (middle > 0.6).any()
    assert (middle < -0.6).any()


def test_lost_answers_are_failures_of_the_connection(world: Callable[..., World]) -> None:
    lost, kept = (
        run_heat(Heat(LINES, world([(3.0, 0.0)]), 0), replace(CONFIG, lost=share))
        for share in (1.0, 0.0)
    )
    assert lost.run.ticks_braked == 5  # none ever arrives, and without a plan it stands
    assert kept.run.ticks_braked == 1


LITTLE = ("--num", "8", "--motions", "24", "--sampler", "euler:uniform1", "--limit-s", "0.3")


def test_it_drives_writes_its_tables_and_goes_on_from_its_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, bundle = tmp_path / "runs.jsonl", shutil.copytree(DEFAULT_BUNDLE, tmp_path / "bundle")
    given = ("bench", "closed-loop", "drawn:1:1", *LITTLE, "--latency-ms", 60)
    given += ("--log", log, "--bundle", bundle, "--out", tmp_path)
    succeed(*given)

    assert "AnchorFlow's MPPI + served anchors, 24 motions" in capsys.readouterr().out
    written = json.loads((tmp_path / "closed_loop.json").read_text())
    contenders, worlds = (table["rows"] for table in written["tables"])
    assert [row["contender"] for row in contenders] == [
        f"{controller}{anchors}, 24 motions"
        for controller in ("AnchorFlow's MPPI", "pytorch_mppi")
        for anchors in ("", " + straight lines", " + routes and finish", " + served anchors")
    ]
    assert [row["request p50 ms"] for row in contenders] == 2 * [None, 60.0, 60.0, 60.0]
    assert all(row["command ms"] > 0.0 for row in contenders)
    assert [row["world"] for row in worlds] == ["drawn 1000"]
    assert written["about"]["latency"] == "60 ms"
    assert (tmp_path / "closed_loop.md").exists()

    taken_down = log.read_bytes().splitlines()
    log.write_bytes(b"\n".join([*taken_down[:-1], b""]))
    succeed(*given)  # drives what is missing alone
    again = log.read_bytes().splitlines()
    assert again[:-1] == taken_down[:-1]
    last = [json.loads(lines[-1]) for lines in (taken_down, again)]
    assert len(again) == len(taken_down) == 1 + len(contenders)
    assert last[0].keys() == last[1].keys()

    # All that changes a run is refused, as far as a contest with nothing left to drive shows it.
    refusal = partial(failure, *given)
    assert "robot: expected runs of" in refusal("--limit-s", "0.4")
    assert "answers lost: expected runs of '0.1%', got runs of '0%'" in refusal("--lost", "0.001")
    assert "latency: expected runs of" in refusal("--latency-ms", "61")
    record_quality(bundle, {"success": 0.5})
    assert "bundle: expected runs of 'flowmp-small 0.3.0 (" in refusal()
