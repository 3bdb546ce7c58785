"""Scenes in and out of the page: files, maps of ROS, and requests copied for other programs."""

from __future__ import annotations

import io
import json
import os
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

from anchorflow_client.contract import AnchorRequest
from anchorflow_client.ros_map import RosMapError, load_ros_map

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


def assert_read_as_by_the_command_line(visit: Any, files: list[Path], yaml: Path) -> None:
    expected = load_ros_map(yaml)
    asked = visit.answer(
        lambda: open_files(visit, files),
        lambda asked: asked["cost_map"]["origin"] == pytest.approx(expected.origin),
    ).asked["cost_map"]

    np.testing.assert_array_equal(np.array(asked["data"][0]) >= 0.5, expected.occupancy >= 0.5)
    assert asked["resolution"] == expected.resolution


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

    assert_read_as_by_the_command_line(visit, files, files[0])

    expect(visit.locate("#scene-note")).to_contain_text(f"{name}: 5.0 × 4.0 m")
    expect(visit.locate("#sample")).to_have_value("own")


PLAIN = YAML.format(image="a.pgm", mode="trinary", negate=0)


@pytest.mark.parametrize(
    "text",
    [
        PLAIN.replace("negate: 0", "negate: false"),
        PLAIN.replace("[-2.0, 1.5, 0.0]", "[-2.0,  # x\n  1.5,\n  0.0]"),
        PLAIN.replace("[-2.0, 1.5, 0.0]", "\n- -2.0\n- 1.5\n- 0"),
        PLAIN + "meta:\n  resolution: 0.5\n  mode: raw\n",
        "\ufeff---\n" + PLAIN.replace("a.pgm", '"a.pgm" # c').replace("\n", "\r\n"),
        PLAIN.replace("a.pgm", "./a.pgm"),
    ],
    ids=["negate false", "origin over lines", "origin as items", "nested", "windows", "path"],
)
def test_a_ros_map_is_read_however_it_is_written(visit: Any, tmp_path: Path, text: str) -> None:
    files = map_files(tmp_path, "a.pgm", as_pgm(drawing()))
    files[0].write_bytes(text.encode())
    another = tmp_path / "0.pgm"
    another.write_bytes(as_pgm(np.zeros((40, 50), np.uint8)))

    assert_read_as_by_the_command_line(visit, [another, *files], files[0])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("image: a.pgm", "image: 3"),
        ("mode: trinary", "mode: dual"),
        ("mode: trinary", "mode:"),
        ("0.65", "65"),
        ("0.65", '"0.65"'),
        ("0.196", "0.7"),
        ("0.196", "0.65"),
        ("negate: 0", "negate: 2"),
        ("resolution: 0.1", "resolution: 0.0000001"),
        ("resolution: 0.1", "resolution: 101"),
        ("resolution: 0.1", "resolution: true"),
        ("resolution: 0.1", "resolution: 1e-1"),
        ("resolution: 0.1\n", ""),
        ("[-2.0, 1.5, 0.0]", "[-2.0, 1.5]"),
        ("[-2.0, 1.5, 0.0]", "[.inf, 1.5, 0.0]"),
        ("[-2.0, 1.5, 0.0]", "[-2.0, 1.5, 0.1]"),
        ("[-2.0, 1.5, 0.0]", "[1.0e+8, 1.5, 0.0]"),
    ],
)
def test_a_ros_map_is_refused_in_the_words_of_the_command_line(
    call: Callable[..., Any], tmp_path: Path, old: str, new: str
) -> None:
    files = map_files(tmp_path, "a.pgm", as_pgm(drawing()))
    files[0].write_text(PLAIN.replace(old, new))
    with pytest.raises(RosMapError) as refused:
        load_ros_map(files[0])
    read = """(m, text) => {
        try {
            return m.readYaml(text, "map.yaml");
        } catch (error) {
            return error.message;
        }
    }"""

    message = call("map/yaml", read, files[0].read_text())

    expected = str(refused.value).removeprefix(f"{tmp_path}/").partition(", got ")[0]
    assert message.partition(", got ")[0] == expected


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


def test_a_robot_stops_where_a_map_is_opened(visit: Any, tmp_path: Path) -> None:
    files = map_files(tmp_path, "far.pgm", as_pgm(drawing()))
    files[0].write_text(files[0].read_text().replace("[-2.0, 1.5", "[100.0, 50.0"))
    visit.answer(lambda: visit.locate("#drive").click(), lambda asked: "warm_start" in asked)

    opened = visit.answer(
        lambda: open_files(visit, files), lambda asked: asked["cost_map"]["origin"][0] == 100
    )

    assert opened.status == 200
    assert opened.asked["x_curr"][0] > 100
    expect(visit.locate("#drive")).to_have_attribute("aria-pressed", "false")
    expect(visit.locate("#drive-note")).to_be_hidden()


def scene(**fields: Any) -> str:
    """A scene as a file: straight ahead on a map without obstacles, and what is given."""
    place = {"x_curr": [-2, 0, 0, 0, 0, 0], "x_goal": [2, 0, 0, 0]}
    free = {"data": np.zeros((1, 50, 60)).tolist(), "resolution": 0.1}
    return json.dumps({"cost_map": free, **place, **fields})


def open_scene(visit: Any, folder: Path, **fields: Any) -> Any:
    """What is asked about it."""
    (folder / "scene.json").write_text(scene(**fields))
    return visit.answer(
        lambda: open_files(visit, [folder / "scene.json"]),
        lambda asked: np.shape(asked["cost_map"]["data"]) == (1, 50, 60),
    ).asked


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            {"map.yaml": YAML.format(image="a.pgm", mode="trinary", negate=0)},
            "names the picture a.pgm",
        ),
        (
            {"map.yaml": YAML.format(image="b.pgm", mode="trinary", negate=0), "a.pgm": "P5"},
            "names the picture b.pgm",
        ),
        ({"a.pgm": "P6\n1 1\n255\n..."}, "a.pgm: expected a PGM picture"),
        ({"a.pgm": "P5\n100 100\n255\nshort"}, "100 × 100 pixels, but the file ends before"),
        ({"a.png": "no picture"}, "a.png: expected a PNG picture"),
        ({"a.json": "{"}, "a.json: Expected a scene in JSON"),
        ({"a.json": '{"x_curr": [1, 2]}'}, "a.json: x_curr: expected 6 numbers, got 2 values"),
        ({"a.json": scene(x_curr=[0, 0, None, 0, 0, 0])}, "x_curr: expected 6 numbers"),
        ({"a.json": scene(num_samples="8")}, 'num_samples: expected a number, got "8".'),
        ({"a.json": scene(robot_radius=[1])}, "robot_radius: expected a number, got 1 values."),
        ({"a.json": scene(w_style=[1, 1])}, "w_style: expected 3 numbers, got 2 values."),
        ({"a.json": scene(w_style=[0, 0, 0])}, "w_style: expected weights above 0"),
        ({"a.json": scene(refine={"smooth": 1})}, "refine.smooth: expected true or false, got 1."),
        (
            {"a.json": scene(sampler={"schedule": {"uniform": "2"}})},
            'sampler.schedule.uniform: expected a number, got "2".',
        ),
        (
            {"a.json": scene(cost_map={"data": [[[0, "x"]]], "resolution": 0.1})},
            "cost_map.data: expected [C,H,W]",
        ),
        (
            {"a.json": '{"format": "anchorflow-drive", "bundle": "goalflow"}'},
            "a.json is no scene but of the format anchorflow-drive: "
            "choose the bundle goalflow first.",
        ),
        (
            {"a.json": '{"format": "anchorflow-drive"}'},
            "a.json is no scene but of the format anchorflow-drive: "
            "choose the bundle that it is for first.",
        ),
        (
            {"a.pgm": "P2\n100000 100000\n255\n0"},
            "a.pgm: expected at most 16 million pixels, got 100000 × 100000.",
        ),
        (
            {"map.yaml": "# a map\n--- {image: a.pgm,\nresolution: 0.1}\n", "a.pgm": "P2"},
            "map.yaml: expected a line for each field; a flow mapping, {…}, is not read here.",
        ),
        (
            {"a.pgm": "P2\n4 4\n100\n" + "50 " * 16},
            "a.pgm: every cell of this map is unknown.",
        ),
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


DROP = """(element, [name, text]) => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([text], name));
  const fire = (type) =>
    element.dispatchEvent(new DragEvent(type, { dataTransfer, bubbles: true, cancelable: true }));
  fire("dragover");
  const said = document.querySelector("#board").hasAttribute("data-drop");
  return [said, fire("drop"), document.querySelector("#board").hasAttribute("data-drop")];
}"""
"""Drops a file; whether the board said so, whether the browser would open it itself, and whether
the board says so still."""


@pytest.mark.parametrize("where", ["#board", "#summary", "#bundle"])
def test_a_drop_anywhere_on_the_page_opens_the_file(visit: Any, where: str) -> None:
    outcome = visit.locate(where).evaluate(DROP, ["a.json", '{"x_curr": [1, 2]}'])

    assert outcome == [True, False, False]
    expect(visit.locate("#scene-note")).to_contain_text("a.json: x_curr: expected 6 numbers")


@pytest.mark.parametrize("side", [4001, 20_000])
def test_a_picture_that_is_too_large_is_refused_by_its_size(
    visit: Any, tmp_path: Path, side: int
) -> None:
    Image.new("1", (side, 4000), 1).save(tmp_path / "large.png")

    open_files(visit, [tmp_path / "large.png"])

    expect(visit.locate("#scene-note")).to_have_text(
        f"large.png: expected at most 16 million pixels, got {side} × 4000."
    )


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


def test_a_scene_keeps_its_acceleration_and_null_is_not_given(visit: Any, tmp_path: Path) -> None:
    own = visit.locate("#radius").input_value()
    visit.locate("#radius").fill("0.4")
    visit.locate("#fixed").check()

    asked = open_scene(
        visit,
        tmp_path,
        x_curr=[-2, 0, 0.5, 0.25, 1.0, -0.5],
        robot_radius=None,
        horizon_s=None,
        refine=None,
    )

    assert asked["x_curr"] == [-2, 0, 0.5, 0.25, 1.0, -0.5]
    assert asked["robot_radius"] == float(own)
    assert "horizon_s" not in asked
    expect(visit.locate("#scene-note")).to_have_text("scene.json is open.")


def test_what_a_scene_has_beyond_the_page_is_named(visit: Any, tmp_path: Path) -> None:
    asked = open_scene(
        visit, tmp_path, budget_ms=500, sampler={"method": "rk4", "schedule": [0, 0.4, 1]}
    )

    assert "sampler" not in asked
    expect(visit.locate("#scene-note")).to_have_text(
        "scene.json is open. Left out: budget_ms, sampler."
    )


def test_a_scene_is_asked_of_the_bundle_that_it_names(
    open_page: Callable[..., Any], served_student: Any, tmp_path: Path
) -> None:
    visit = open_page(served_student.url)
    visit.wait_for_anchors()

    asked = open_scene(visit, tmp_path, model="flowmp-small-student", robot_radius=0.3)

    assert (asked["model"], asked["robot_radius"]) == ("flowmp-small-student", 0.3)
    expect(visit.locate("#bundle")).to_have_value("flowmp-small-student")
    for model in ("v2x", "another"):
        assert open_scene(visit, tmp_path, model=model)["model"] == "flowmp-small-student"
        expect(visit.locate("#scene-note")).to_have_text(
            f"scene.json is open. Left out: model, as no {model} with a map is served."
        )
    assert visit.errors == []


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


def test_a_copy_without_the_clipboard_leaves_the_focus_where_it_is(visit: Any) -> None:
    """As on a page that came over plain HTTP from another machine."""
    visit.page.evaluate(
        "() => { navigator.clipboard.writeText = () => Promise.reject(new Error()); }"
    )
    visit.locate("#copy-curl").focus()

    visit.page.keyboard.press("Enter")

    expect(visit.locate("#scene-note")).to_have_text("Copied for curl.")
    expect(visit.locate("#copy-curl")).to_be_focused()


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_what_is_copied_from_a_service_with_tokens_takes_the_token_from_the_environment(
    open_page: Callable[..., Any], guarded: Any, copied: Callable[[Any, str], str]
) -> None:
    visit = open_page(guarded.url)
    visit.locate("#token").fill("open sesame")
    visit.page.keyboard.press("Enter")
    visit.wait_for_anchors()
    environment = {**os.environ, "ANCHORFLOW_TOKEN": "open sesame"}

    for button, run in (("#copy-curl", ["bash", "-c"]), ("#copy-python", [sys.executable, "-c"])):
        text = copied(visit, button)
        assert "open sesame" not in text
        told = subprocess.run(
            [*run, text], check=True, capture_output=True, env=environment, timeout=120
        )
        assert b"trajectories" in told.stdout or b"anchors are safe" in told.stdout
    expect(visit.locate("#scene-note")).to_contain_text("it takes the token from ANCHORFLOW_TOKEN")
