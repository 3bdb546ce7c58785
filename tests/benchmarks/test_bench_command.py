"""`anchorflow bench` from end to end, on as little as it takes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from anchorflow_benchmarks.options import STUDENT
from anchorflow_benchmarks.programs import served
from anchorflow_cli.main import main
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle


def run(*arguments: str) -> None:
    """The command, which ends with status 0."""
    with pytest.raises(SystemExit) as caught:
        main(["bench", *arguments])
    assert caught.value.code in (0, None), caught.value.code


def tables(path: Path) -> dict[str, list[dict]]:
    return {table["title"]: table["rows"] for table in json.loads(path.read_text())["tables"]}


def test_quality_of_two_bundles_with_its_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bundles = [tmp_path / name for name in ("default", "student")]
    for bundle in bundles:
        shutil.copytree(DEFAULT_BUNDLE.parent / bundle.name, bundle)
    asked = [option for bundle in bundles for option in ("--bundle", str(bundle))]
    options = ("--scenes", "drawn:2:1", "--num", "4", "--samplers", "card,euler:uniform2")
    out = tmp_path / "out"
    run("quality", *asked, *options, "--baselines", "lines", "--record", "--out", str(out))

    assert "euler:uniform2" in capsys.readouterr().out
    names = ("quality.json", "quality.md", "quality_scenes.png", "quality_time.png")
    assert {path.name for path in out.iterdir()} == {*names}
    rows = tables(out / "quality.json")["All scenes (2)"]
    planners = [row["planner"] for row in rows]
    assert planners[1].endswith("euler:uniform2")
    assert planners[4:] == ["lines with noise", "lines with noise, refined"]
    assert rows[0]["unsafe_called_safe"] == 0
    for bundle, row in zip(bundles, rows[:4:2], strict=True):
        quality = load_bundle(bundle).card.quality
        assert quality["scenes"] == "drawn:2:1, 2 judged"
        assert quality["success"] == pytest.approx(row["success"], abs=1e-4)
        assert quality["evaluations"] == row["evaluations"]
        assert not {"planner", "ms"} & quality.keys()


def test_load_of_a_server_of_its_own(tmp_path: Path) -> None:
    options = ("--scenes", "drawn:1:1", "--num", "2", "--sampler", "euler:uniform1")
    run("load", *options, "--clients", "1", "--requests", "5", "--out", str(tmp_path))

    rows = tables(tmp_path / "load.json")["Load"]
    assert [(row["way"], row["requests"], row["errors"]) for row in rows] == [
        ("in-process", 5, 0),
        ("HTTP JSON", 5, 0),
        ("HTTP JSON, standard library", 5, 0),
        ("HTTP binary", 5, 0),
    ]


NO_SCENES = ("--scenes", "nowhere.npz")
"""So that a command that is not refused ends all the same."""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("load", "--url", "http://192.0.2.1"), "such as http://127.0.0.1:8000, got"),
        (("load", "--url", "http://127.0.0.1:1"), "http://127.0.0.1:1: [Errno 111]"),
        (("load", "--clients", "0,x"), "--clients: expected whole numbers"),
        (("quality", "--baselines", "luck"), "'luck'"),
        (("quality", "--samplers", "rk4"), "'rk4'"),
        (("latency", "--checkpoint", "a.pt", "--checkpoint", "b.pt"), "at most one --checkpoint"),
        (("quality", "--scenes", "nowhere.npz"), "nowhere.npz: not a file of scenes"),
        (("quality", "--routes", "nowhere.npz"), "nowhere.npz: not a file of routes"),
        (("quality", "--v-max", "9", "--scenes", "drawn:1:0"), "v_max: expected 0.2 to 6 m/s"),
        (
            ("quality", "--v-max", "0", *NO_SCENES),
            "--v-max: expected a number in (0, 100] m/s, got 0",
        ),
        (
            ("quality", "--a-max", "0", *NO_SCENES),
            "--a-max: expected a number in (0, 1000] m/s^2, got 0",
        ),
        (
            ("quality", "--radius", "0", *NO_SCENES),
            "--radius: expected a number in (0, 5] m, got 0",
        ),
    ],
)
def test_what_cannot_be_measured_is_one_line(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["bench", *arguments, "--out", str(tmp_path)])

    line = str(caught.value.code)
    assert line.startswith("anchorflow bench: ")
    assert message in line
    assert "\n" not in line


def test_a_server_of_another_model_is_not_compared() -> None:
    with served() as url, pytest.raises(SystemExit) as caught:
        main(["bench", "load", "--url", url, "--bundle", str(STUDENT)])
    assert "expected a server of flowmp-small-student" in str(caught.value.code)
