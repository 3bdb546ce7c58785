"""`anchorflow bench closed-loop` from end to end, on as little as it takes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from anchorflow_cli.main import main
from anchorflow_export.bundle import record_quality
from anchorflow_service.bundle import DEFAULT_BUNDLE

LITTLE = ("--num", "8", "--motions", "24", "--sampler", "euler:uniform1", "--limit-s", "0.3")


def run(*arguments: str) -> None:
    """The command, which ends with status 0."""
    with pytest.raises(SystemExit) as caught:
        main(["bench", "closed-loop", *arguments])
    assert caught.value.code in (0, None), caught.value.code


def test_it_drives_and_writes_its_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("drawn:3:1", "--limit", "2", *LITTLE, "--latency-ms", "60", "--out", str(tmp_path))

    assert "MPPI + served anchors, 24 motions" in capsys.readouterr().out
    written = json.loads((tmp_path / "closed_loop.json").read_text())
    contenders, worlds = (table["rows"] for table in written["tables"])
    assert [row["contender"] for row in contenders] == [
        "MPPI, 24 motions",
        "MPPI + straight lines, 24 motions",
        "MPPI + routes and finish, 24 motions",
        "MPPI + served anchors, 24 motions",
    ]
    assert [row["request p50 ms"] for row in contenders] == [None, 60.0, 60.0, 60.0]
    assert [row["world"] for row in worlds] == ["drawn 1000", "drawn 1002"]
    assert written["about"]["latency"] == "60 ms"
    assert (tmp_path / "closed_loop.md").exists()


def test_the_runs_of_a_log_are_of_all_that_changes_one(tmp_path: Path) -> None:
    """As far as a contest that has nothing left to drive shows it."""
    log, bundle = tmp_path / "runs.jsonl", shutil.copytree(DEFAULT_BUNDLE, tmp_path / "bundle")
    given = [
        "drawn:1:0",
        *LITTLE,
        "--log",
        str(log),
        "--bundle",
        str(bundle),
        "--out",
        str(tmp_path),
    ]
    run(*given)
    taken_down = log.read_bytes()
    run(*given)
    assert log.read_bytes() == taken_down

    def refusal(*arguments: str) -> str:
        with pytest.raises(SystemExit) as caught:
            main(["bench", "closed-loop", *given, *arguments])
        return str(caught.value.code)

    assert "robot: expected runs of" in refusal("--limit-s", "0.4")
    assert "answers lost: expected runs of '0.1%', got runs of '0%'" in refusal("--lost", "0.001")
    assert "latency: expected runs of" in refusal("--threads", "1")
    record_quality(bundle, {"success": 0.5})
    assert "bundle: expected runs of 'flowmp-small 0.3.0 (" in refusal()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("drawn:1:0", "--robot", "hovercraft"), "--robot: expected unicycle or"),
        (("drawn:1:0", "--motions", "many"), "--motions: expected whole numbers"),
        (("drawn:1:0", "--motions", "65"), "expected at least 66, for 64 anchors"),
        (("nowhere.npz",), "nowhere.npz: not a file of worlds"),
        (("drawn:1:0", "--sampler", "luck"), "'luck'"),
        (("drawn:1:0", "--url", "http://127.0.0.1:1"), "http://127.0.0.1:1: [Errno 111]"),
    ],
)
def test_what_cannot_be_driven_is_one_line(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["bench", "closed-loop", *arguments, "--out", str(tmp_path)])

    line = str(caught.value.code)
    assert line.startswith("anchorflow bench: ")
    assert message in line
    assert "\n" not in line
