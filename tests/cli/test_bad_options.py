"""Invalid options are refused before any work, with a message that names them.

Long-running commands also lack another input, so that they end even if they are not refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import failure
from ros_maps import write_map

from anchorflow_service.bundle import DEFAULT_BUNDLE

V2X = DEFAULT_BUNDLE.parent / "v2x"
GOALFLOW = Path(__file__).parents[2] / "checkpoints" / "goalflow.pt"


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
        ("bench drive-closed-loop --drivers nobody --keep FILE", FOLDER_WANTED),
    ],
)
def test_a_place_that_cannot_be_written(command: str, wanted: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    places = {"FILE": str(tmp_path / "file"), "DIR": str(tmp_path), "EMPTY": ""}
    words = [
        str(Path(places[word.split("/")[0]], *word.split("/")[1:]))
        if "/" in word
        else places.get(word, word)
        for word in command.split()
    ]
    said = failure(*words)
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
        "serve --bundle none --notice-s inf",
        "serve --bundle none --drain-s inf",
        "serve --bundle none --batch-wait-ms inf",
        "data from-poses DIR p.npz --rate-hz inf",
    ],
)
def test_a_number_without_an_end(command: str) -> None:
    *words, option, number = command.split()
    said = failure(*words, option, number)
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
def test_a_url_of_no_service(command: str, url: str) -> None:
    option = "--traces" if command.startswith("serve") else "--url"
    said = failure(*command.split(), option, url)
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
def test_an_end_beyond_the_contract(command: str, option: str, value: str, interval: str) -> None:
    words = {"--start": "0,0", "--goal": "1,1", option: value}
    said = failure(*command.split(), *(word for pair in words.items() for word in pair))
    assert f"'{option}': expected numbers in {interval}, got {value!r}" in said


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (
            "plan --map no.yaml --start 0,0 --goal 1,1 --bundle x --url http://127.0.0.1",
            "expected --url or --bundle, got both",
        ),
        (
            "serve --bundle none --port 0 --host=",
            "--host: expected an address, such as 127.0.0.1, got ''",
        ),
        ("plan --map m.yaml --start 1;2 --goal 1,1", "2 or 3 numbers X,Y[,HEADING], got '1;2'"),
        (f"bench pairs {DEFAULT_BUNDLE}", "expected a bundle asked with pictures, got cost_map"),
        (f"bench pairs {GOALFLOW}", "expected a v2x_vlm, got one of goalflow"),
        (f"bench pairs {V2X} {V2X}", "expected bundles of different names, got v2x"),
        ("data anchors DIR --out a.npy", "expected logs (*.npz)"),
        ("bench drive --logs DIR --out x", ": folder: expected logs (*.npz), found none"),
    ],
)
def test_what_cannot_be_done_is_said(command: str, said: str, tmp_path: Path) -> None:
    assert said in failure(*command.replace("DIR", str(tmp_path)).split())


def test_a_square_too_small(tmp_path: Path) -> None:
    room = write_map(tmp_path, np.full((100, 100), 254, np.uint8))
    words = "generate --checkpoint a.pt --start 1,1 --goal 9,9 --size 3 --map"
    assert "--size: expected more than 8 m" in failure(*words.split(), room)
