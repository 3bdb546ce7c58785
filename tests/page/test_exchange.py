"""Scenes in and out of the page: files, maps of ROS, and requests copied for other programs."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from anchorflow_cli.ros_map import load_ros_map
from anchorflow_client.contract import AnchorRequest

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect = sync_api.expect

YAML = """image: {image}
resolution: 0.1
origin: [-2.0, 1.5, 0.0]
negate: {negate}
occupied_thresh: 0.65
free_thresh: 0.196
mode: {mode}
"""


def drawing() -> np.ndarray:
    """[40, 50] grey levels, top row first; known at the edges, so that nothing is trimmed."""
    grey = np.full((40, 50), 254, np.uint8)
    grey[5:12, 10:30] = 0
    grey[20:24, 20:24] = 205  # between the thresholds: unknown
    grey[0, 0] = 0
    return grey


def as_pgm(grey: np.ndarray, *, text: bool = False) -> bytes:
    height, width = grey.shape
    head = f"{'P2' if text else 'P5'}\n# a comment\n{width} {height}\n255\n".encode()
    return head + (" ".join(map(str, grey.ravel())).encode() if text else grey.tobytes())


def as_png(grey: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(grey).save(file, "png")
    return file.getvalue()


def as_transparent_png(grey: np.ndarray) -> bytes:
    """Two pixels see-through: they are unknown whatever their colour is."""
    channels = np.dstack([grey, grey, grey, np.full_like(grey, 255)])
    channels[30, 40:42, 3] = 0
    file = io.BytesIO()
    Image.fromarray(channels).save(file, "png")
    return file.getvalue()


def map_files(
    folder: Path, name: str, picture: bytes, *, mode: str = "trinary", negate: int = 0
) -> list[Path]:
    """A YAML file and its picture."""
    (folder / name).write_bytes(picture)
    (folder / "map.yaml").write_text(YAML.format(image=name, mode=mode, negate=negate))
    return [folder / "map.yaml", folder / name]


def open_files(visit: Any, files: list[Path]) -> None:
    visit.locate("#files").set_input_files(files)


@pytest.mark.parametrize(
    ("name", "write", "options"),
    [
        ("bytes.pgm", as_pgm, {}),
        ("text.pgm", lambda grey: as_pgm(grey, text=True), {}),
        ("grey.png", as_png, {}),
        ("see-through.png", as_transparent_png, {}),
        ("negative.pgm", lambda grey: as_pgm(255 - grey), {"negate": 1}),
        (
            "raw.pgm",
            lambda grey: as_pgm((100 - grey / 2.54).round().astype(np.uint8)),
            {"mode": "raw"},
        ),
    ],
)
def test_a_ros_map_is_read_as_the_command_line_reads_it(
    visit: Any,
    tmp_path: Path,
    name: str,
    write: Callable[[np.ndarray], bytes],
    options: dict[str, Any],
) -> None:
    files = map_files(tmp_path, name, write(drawing()), **options)
    expected = load_ros_map(files[0])

    asked = visit.answer(
        lambda: open_files(visit, files), lambda asked: asked["cost_map"]["resolution"] == 0.1
    ).asked["cost_map"]

    np.testing.assert_array_equal(np.array(asked["data"][0]) >= 0.5, expected.occupancy >= 0.5)
    assert asked["origin"] == pytest.approx(expected.origin)
    expect(visit.locate("#scene-note")).to_contain_text(f"{name}: 5.0 × 4.0 m")
    expect(visit.locate("#sample")).to_have_value("own")


def test_a_large_map_loses_no_obstacle(visit: Any, tmp_path: Path) -> None:
    grey = np.full((400, 500), 254, np.uint8)
    grey[200, 250] = 0
    files = map_files(tmp_path, "large.pgm", as_pgm(grey))

    asked = visit.answer(
        lambda: open_files(visit, files), lambda asked: asked["cost_map"]["resolution"] > 0.1
    ).asked["cost_map"]

    grid = np.array(asked["data"][0])
    assert max(grid.shape) <= 160
    assert asked["resolution"] == pytest.approx(0.4)
    # The pixel's row counts from the top.
    assert np.argwhere(grid).tolist() == [[(399 - 200) // 4, 250 // 4]]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            {"map.yaml": YAML.format(image="a.pgm", mode="trinary", negate=0)},
            "names the picture a.pgm",
        ),
        ({"map.yaml": "image: a.pgm\n", "a.pgm": "P5"}, "map.yaml: resolution: expected a number"),
        ({"a.pgm": "P6\n1 1\n255\n..."}, "a.pgm: expected a PGM picture"),
        ({"a.pgm": "P5\n100 100\n255\nshort"}, "100 × 100 pixels, but the file ends before"),
        ({"a.png": "no picture"}, "a.png: expected a PNG picture"),
        ({"a.json": "{"}, "Expected a scene in JSON"),
        ({"a.json": '{"x_curr": [1, 2]}'}, "x_curr: expected 6 numbers, got 2 values"),
        ({"a.txt": "hello"}, "a.txt: expected .json, .yaml with its picture"),
    ],
)
def test_a_file_that_cannot_be_read_is_explained(
    visit: Any, tmp_path: Path, files: dict[str, str], message: str
) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)

    open_files(visit, [tmp_path / name for name in files])

    expect(visit.locate("#scene-note")).to_contain_text(message)


def test_a_saved_scene_is_a_request_and_opens_again(visit: Any, tmp_path: Path) -> None:
    visit.locate("#num").fill("8")
    visit.locate("#seed").fill("7")
    before = visit.answer(
        lambda: visit.locate("#seed").press("Enter"), lambda asked: asked["seed"] == 7
    )
    with visit.page.expect_download() as download:
        visit.locate("#save").click()
    saved = tmp_path / download.value.suggested_filename
    download.value.save_as(saved)

    AnchorRequest.from_fields(json.loads(saved.read_text()))
    assert json.loads(saved.read_text()) == before.asked
    visit.answer(
        lambda: visit.locate("#sample").select_option("maze"),
        lambda asked: asked["cost_map"] != before.asked["cost_map"],
    )
    again = visit.answer(
        lambda: open_files(visit, [saved]),
        lambda asked: asked["cost_map"] == before.asked["cost_map"],
    )

    assert again.asked == before.asked
    assert again.answered["trajectories"] == before.answered["trajectories"]


def ask_for_few(visit: Any) -> Any:
    visit.locate("#num").fill("4")
    return visit.answer(
        lambda: visit.locate("#margin").fill("0.15"),
        lambda asked: (asked["num_samples"], asked["refine"]["safety_margin"]) == (4, 0.15),
    )


def test_the_request_copied_for_python_runs_and_gives_the_same(
    visit: Any, copied: Callable[[Any, str], str]
) -> None:
    shown = ask_for_few(visit).answered
    program = (
        copied(visit, "#copy-python")
        + "\nimport json\nprint('JSON', json.dumps(anchors.trajectories.tolist()))\n"
    )

    run = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True, timeout=120
    )

    assert f"{shown['safe'].count(True)} of 4 anchors are safe" in run.stdout
    paths = json.loads(re.search(r"^JSON (.*)$", run.stdout, re.MULTILINE)[1])  # type: ignore[index]
    np.testing.assert_allclose(paths, shown["trajectories"], atol=1e-5)


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_request_copied_for_curl_runs_and_gives_the_same(
    visit: Any, copied: Callable[[Any, str], str]
) -> None:
    shown = ask_for_few(visit).answered

    run = subprocess.run(
        ["bash", "-c", copied(visit, "#copy-curl")], check=True, capture_output=True, timeout=120
    )

    paths = json.loads(run.stdout)["trajectories"]
    np.testing.assert_allclose(paths, shown["trajectories"], atol=1e-6)
