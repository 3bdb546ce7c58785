"""The table of `anchorflow bench drive-closed-loop`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import succeed

from anchorflow_driving.log import read_log
from anchorflow_service.bundle import DEFAULT_BUNDLE

for _module in ("sumo", "libsumo"):
    pytest.importorskip(_module, reason=f"{_module} is not installed")


def test_the_table_counts_how_routes_ended() -> None:
    from anchorflow_benchmarks.driving.closed_loop import (
        ClosedLoopConfig,
        RouteResult,
        routes_table,
    )

    results = [
        RouteResult("completed", 301.0, 300.0, 40.0, [True, True], [2.0, 4.0]),
        RouteResult("completed", 300.0, 300.0, 50.0, [True, False], [3.0]),
        RouteResult("collision", 150.0, 150.0, 20.0, [True], [3.0]),
        RouteResult("off road", 30.0, 50.0, 3.0, [], [9.0]),
        RouteResult("off route", 60.0, 200.0, 30.0, [False], [3.0]),
    ]

    table = routes_table({"somebody": results}, ClosedLoopConfig())

    assert table.rows == [
        {
            "driver": "somebody",
            "completed": 0.4,
            "progress": pytest.approx(0.56),
            "collisions/km": pytest.approx(1.0),
            "off road/km": pytest.approx(1.0),
            "off route": 1,
            "out of time": 0,
            "km": pytest.approx(1.0),
            "comfort": pytest.approx(4 / 6),
            "s": 45.0,
            "ms": 3.0,
        }
    ]


def test_the_command_writes_it(tmp_path: Path) -> None:
    options = ["--drivers", "stop", "--routes", "1", "--seconds", "5", "--out", str(tmp_path)]
    options += ["--bundle", str(DEFAULT_BUNDLE.parent / "goalflow"), "--along-route"]
    options += ["--keep", str(tmp_path / "kept" / "drives")]
    succeed("bench", "drive-closed-loop", *options)

    (table,) = json.loads((tmp_path / "drive_closed_loop.json").read_text())["tables"]
    names = [row["driver"] for row in table["rows"]]
    assert names == ["stop", "goalflow", "goalflow_along_route"]
    assert table["rows"][0]["completed"] == 0
    assert table["rows"][1]["km"] > table["rows"][0]["km"]
    kept = {log.name: read_log(log) for log in (tmp_path / "kept" / "drives").iterdir()}
    assert {*kept} == {f"{name}-driven-2000-00000.npz" for name in names}
    assert all(log.windows for log in kept.values())
