"""Invalid options are refused before any work, with a message that names them.

Long-running commands also lack another input, so that they end even if they are not refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from anchorflow_cli.main import main


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must fail, and return its message on one line."""
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code not in (0, None)
    said = capsys.readouterr().err if caught.value.code == 2 else str(caught.value.code)
    return " ".join(said.split())


FILE_WANTED, FOLDER_WANTED = "expected a file to write, got", "expected a folder to write, got"


@pytest.mark.parametrize(
    ("command", "wanted"),
    [
        ("data make FILE", FOLDER_WANTED),
        ("data import x.npz FILE", FOLDER_WANTED),
        ("data drive --out FILE", FOLDER_WANTED),
        ("data drive --out FILE/x", FOLDER_WANTED),
        ("data crossings FILE", FOLDER_WANTED),
        ("data pairs DIR FILE", FOLDER_WANTED),
        ("data anchors DIR --out FILE/x.npy", FILE_WANTED),
        ("data anchors DIR --out DIR", FILE_WANTED),
        ("data frames log.npz --bundle DIR --out DIR", FILE_WANTED),
        ("data import-log a.xml --out DIR", FILE_WANTED),
        ("train DIR --out FILE", FOLDER_WANTED),
        ("export a.pt --out FILE/x", FOLDER_WANTED),
        ("average a.pt b.pt --out DIR", FILE_WANTED),
        ("average a.pt b.pt --out EMPTY", FILE_WANTED),
        ("distill a.pt DIR --out DIR --pairs FILE", FOLDER_WANTED),
        ("generate --checkpoint a.pt --start 0,0 --goal 1,1 --out DIR", FILE_WANTED),
        ("generate --checkpoint a.pt --start 0,0 --goal 1,1 --plot FILE/x.png", FILE_WANTED),
        ("plan --map m.yaml --start 0,0 --goal 1,1 --out FILE/x.png", FILE_WANTED),
        ("data inspect x.npz --out FILE/x.png", FILE_WANTED),
        ("data from-poses DIR FILE/x.npz", FILE_WANTED),
        ("data from-poses DIR FILE", "expected a file .npz, got"),
        ("bench closed-loop drawn:1:0 --log DIR", FILE_WANTED),
        ("bench quality --scenes none.npz --out FILE", FOLDER_WANTED),
        ("bench drive --logs DIR --plans FILE", FOLDER_WANTED),
    ],
)
def test_a_place_that_cannot_be_written(
    command: str, wanted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    places = {"FILE": str(tmp_path / "file"), "DIR": str(tmp_path), "EMPTY": ""}
    words = [
        str(Path(places[word.split("/")[0]], *word.split("/")[1:]))
        if "/" in word
        else places.get(word, word)
        for word in command.split()
    ]
    said = refused(capsys, *words)
    assert any(f"{wanted} {form}" in said for form in (words[-1] or "''", repr(words[-1])))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


@pytest.mark.parametrize(
    "command",
    [
        "data drive --out x --seconds inf",
        "data frames log.npz --bundle x --out x.json --every nan",
        "data frames log.npz --bundle x --out x.json --every inf",
        "bench latency --scenes none.npz --budget-s nan",
        "bench drive-closed-loop --drivers nobody --seconds inf",
        "serve --bundle none --drain-s inf",
    ],
)
def test_a_number_without_an_end(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    *words, option, number = command.split()
    said = refused(capsys, *words, option, number)
    assert f"'{option}': expected a finite number, got {number}" in said


@pytest.mark.parametrize("url", ["nonsense", "127.0.0.1", "http://127.0.0.1:abc", ""])
@pytest.mark.parametrize(
    "command",
    [
        "plan --map no.yaml --start 0,0 --goal 1,1",
        "bench load",
        "bench closed-loop drawn:1:0",
        "serve --bundle none",
    ],
)
def test_a_url_of_no_service(command: str, url: str, capsys: pytest.CaptureFixture[str]) -> None:
    option = "--traces" if command.startswith("serve") else "--url"
    said = refused(capsys, *command.split(), option, url)
    assert f"'{option}': expected http://host[:port] or https://host[:port], got {url!r}" in said


@pytest.mark.parametrize(
    ("option", "value", "interval"),
    [
        ("--start", "1e300,0", "[-1e+07, 1e+07] m"),
        ("--goal", "0,-1e8", "[-1e+07, 1e+07] m"),
        ("--start-velocity", "101,0", "[-100, 100] m/s"),
    ],
)
@pytest.mark.parametrize("command", ["plan --map no.yaml", "generate --checkpoint no.pt"])
def test_an_end_beyond_the_contract(
    command: str, option: str, value: str, interval: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = {"--start": "0,0", "--goal": "1,1", option: value}
    said = refused(capsys, *command.split(), *(word for pair in words.items() for word in pair))
    assert f"'{option}': expected numbers in {interval}, got {value!r}" in said


def test_a_server_and_a_bundle(capsys: pytest.CaptureFixture[str]) -> None:
    words = "plan --map no.yaml --start 0,0 --goal 1,1 --bundle x --url http://127.0.0.1"
    assert "expected --url or --bundle, got both" in refused(capsys, *words.split())


def test_no_host(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--host: expected an address, such as 127.0.0.1, got ''" in refused(
        capsys, "serve", "--bundle", "none", "--host", "", "--port", "0"
    )


def test_a_square_too_small(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from PIL import Image

    Image.fromarray(np.full((100, 100), 254, np.uint8)).save(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    words = f"generate --checkpoint a.pt --start 1,1 --goal 9,9 --map {tmp_path}/map.yaml --size 3"
    assert "--size: expected more than 8 m" in refused(capsys, *words.split())
