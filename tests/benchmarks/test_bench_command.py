"""`anchorflow bench` from end to end, on as little as it takes."""

from __future__ import annotations

import json
import shutil
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from command_line import failure, succeed

from anchorflow_benchmarks.options import STUDENT
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle


def tables(path: Path) -> dict[str, list[dict]]:
    return {table["title"]: table["rows"] for table in json.loads(path.read_text())["tables"]}


def test_quality_of_two_bundles_with_its_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bundles = [tmp_path / name for name in ("default", "student")]
    for bundle in bundles:
        shutil.copytree(DEFAULT_BUNDLE.parent / bundle.name, bundle)
    asked = [option for bundle in bundles for option in ("--bundle", str(bundle))]
    options = ["--scenes", "drawn:1:1", "--num", "2", "--samplers", "card,euler:uniform2"]
    out = tmp_path / "out"
    options += ["--baselines", "lines", "--no-styles", "--record"]
    succeed("bench", "quality", *asked, *options, "--out", out)

    assert "euler:uniform2" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"quality.json", "quality.md"}
    rows = tables(out / "quality.json")["All scenes (1)"]
    planners = [row["planner"] for row in rows]
    assert planners[1].endswith("euler:uniform2")
    assert planners[4:] == ["lines with noise", "lines with noise, refined"]
    assert rows[0]["unsafe_called_safe"] == 0
    for bundle, row in zip(bundles, rows[:4:2], strict=True):
        quality = load_bundle(bundle).card.quality
        assert quality["scenes"] == "drawn:1:1, 1 judged"
        assert quality["success"] == pytest.approx(row["success"], abs=1e-4)
        assert quality["evaluations"] == row["evaluations"]
        assert not {"planner", "ms"} & quality.keys()


def test_load_of_a_server_of_its_own(tmp_path: Path) -> None:
    options = ("--scenes", "drawn:1:1", "--num", "2", "--sampler", "euler:uniform1")
    succeed("bench", "load", *options, "--clients", 1, "--requests", 5, "--out", tmp_path)

    rows = tables(tmp_path / "load.json")["Load"]
    assert [(row["way"], row["requests"], row["errors"]) for row in rows] == [
        ("in-process", 5, 0),
        ("HTTP JSON", 5, 0),
        ("HTTP JSON, standard library", 5, 0),
        ("HTTP binary", 5, 0),
    ]


WORLD = ("drawn:1:0",)
NO_SCENES = ("--scenes", "nowhere.npz")
"""So that a command that is not refused ends all the same."""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("load", "--url", "http://192.0.2.1"), "such as http://127.0.0.1:8000, got"),
        (("drive-closed-loop", "--drivers", "human"), "got 'human'"),
        (("closed-loop", *WORLD, "--robot", "hovercraft"), "--robot: expected unicycle or"),
        (("closed-loop", *WORLD, "--motions", "many"), "--motions: expected whole numbers"),
        (("closed-loop", *WORLD, "--motions", "65"), "expected at least 66, for 64 anchors"),
        (("closed-loop", "nowhere.npz"), "nowhere.npz: not a file of worlds"),
        (("closed-loop", *WORLD, "--sampler", "luck"), "'luck'"),
        (("closed-loop", *WORLD, "--url", "http://127.0.0.1:1"), "[Errno 111]"),
        (("crowds", "--robot", "hovercraft"), "--robot: expected double-integrator or"),
        (
            ("crowds", "--drivers", "luck"),
            "expected some of tracks, discs, mppi, straight, cfm-mppi, got luck",
        ),
        (("crowds", "--windows", "nowhere.npz"), "nowhere.npz: not a file of people"),
        (("load", "--url", "http://127.0.0.1:1"), "http://127.0.0.1:1: [Errno 111]"),
        (("load", "--clients", "0,x"), "--clients: expected whole numbers"),
        (("quality", "--baselines", "luck"), "'luck'"),
        (("quality", "--samplers", "rk4"), "'rk4'"),
        (("latency", "--checkpoint", "a.pt", "--checkpoint", "b.pt"), "at most one --checkpoint"),
        (("quality", "--scenes", "nowhere.npz"), "nowhere.npz: not a file of scenes"),
        (("quality", "--routes", "nowhere.npz"), "nowhere.npz: not a file of routes"),
        (("quality", "--v-max", "9", "--scenes", "drawn:1:0"), "v_max: expected 0.2 to 6 m/s"),
        (("quality", "--v-max", "0", *NO_SCENES), "--v-max: expected a number in (0, 100] m/s,"),
        (("quality", "--a-max", "0", *NO_SCENES), "--a-max: expected a number in (0, 1000] m/s^2"),
        (("quality", "--radius", "0", *NO_SCENES), "--radius: expected a number in (0, 5] m, got"),
    ],
)
def test_what_cannot_be_measured_is_one_line(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    if arguments[0] == "drive-closed-loop":
        pytest.importorskip("libsumo", reason="libsumo is not installed")
    assert message in failure("bench", *arguments, "--out", tmp_path)


class DefaultCards(BaseHTTPRequestHandler):
    """A server of the default bundle, as far as its cards tell."""

    def do_GET(self) -> None:
        models = [load_bundle(DEFAULT_BUNDLE).card.to_dict() | {"ready": True}]
        body = json.dumps({"models": models}).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


@pytest.mark.usefixtures("capfd")  # the server's log
def test_a_server_of_another_model_is_not_compared() -> None:
    with HTTPServer(("127.0.0.1", 0), DefaultCards) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        url = f"http://127.0.0.1:{server.server_port}"
        said = failure("bench", "load", "--url", url, "--bundle", STUDENT)
        thread.join(20)
    assert "expected a server of flowmp-small-student" in said
