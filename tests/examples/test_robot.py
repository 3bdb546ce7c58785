"""The example robot, for as long as it takes to see that it runs."""

from __future__ import annotations

import importlib
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "robot"


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Callable[[list[str]], None]:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.syspath_prepend(EXAMPLE)
    return importlib.import_module("robot").main


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def test_alone_it_drives_and_is_recorded(
    robot: Callable[[list[str]], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.gif"
    robot(["--alone", "--limit-s", "0.5", "--record", str(path)])

    assert capsys.readouterr().out.startswith("timeout after 0.5 s and 0.")
    with Image.open(path) as animation:
        assert animation.n_frames == 3  # every other of five ticks
        animation.seek(2)
        assert animation.info["duration"] == 200


def test_without_a_service_it_says_so_and_stands(
    robot: Callable[[list[str]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    robot(["--limit-s", "0.3", "--url", f"http://127.0.0.1:{free_port()}", "--robot", "unicycle"])

    printed = capsys.readouterr().out
    assert "timeout after 0.3 s and 0.0 m" in printed
    assert "3 ticks braked for want of a plan" in printed
    assert printed.count("ConnectionFailed: http://127.0.0.1") == 1


def test_a_file_of_something_else_is_one_line(robot: Callable[[list[str]], None]) -> None:
    with pytest.raises(SystemExit, match=r"nowhere\.npz: not a file of worlds"):
        robot(["--alone", "--worlds", "nowhere.npz"])


@pytest.mark.parametrize(
    ("option", "given", "wanted"),
    [
        ("--max-age", "0", "expected a finite number above 0"),
        ("--max-age", "nan", "expected a finite number above 0"),
        ("--limit-s", "nan", "expected a finite number above 0"),
        ("--limit-s", "-1", "expected a finite number above 0"),
        ("--seed", "-1", "expected a whole number of at least 0"),
        ("--world", "-1", "expected a whole number of at least 0"),
        ("--num", "0", "expected a whole number of at least 1"),
        ("--steps", "0", "expected a whole number of at least 1"),
        ("--record", "x.foo", "expected a file .gif in a folder that is there"),
        ("--record", "nodir/x.gif", "expected a file .gif in a folder that is there"),
    ],
)
def test_an_option_out_of_its_range_is_one_line(
    robot: Callable[[list[str]], None],
    option: str,
    given: str,
    wanted: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit, match="2"):
        robot(["--alone", f"{option}={given}"])
    assert f"argument {option}: {wanted}, got {given!r}" in capsys.readouterr().err


def test_a_url_of_no_service_is_one_line(robot: Callable[[list[str]], None]) -> None:
    with pytest.raises(SystemExit, match=r"^--url: expected http://host.* got 'nonsense'$"):
        robot(["--url", "nonsense"])
