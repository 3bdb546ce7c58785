"""Scenes and maps of ROS in files, and requests that are copied for other programs."""

from __future__ import annotations

import io
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import expect
from command_line import printed_by
from PIL import Image
from ros_maps import drawing, map_files, pgm

from anchorflow_client.contract import AnchorRequest
from anchorflow_client.ros_map import load_ros_map


def png(grey: np.ndarray) -> bytes:
    """A PNG file; two of its pixels are transparent, which means unknown in any colour."""
    channels = np.dstack([grey, grey, grey, np.full_like(grey, 255)])
    channels[30, 40:42, 3] = 0
    file = io.BytesIO()
    Image.fromarray(channels).save(file, "png")
    return file.getvalue()


def open_files(visit: Any, files: list[Path]) -> None:
    visit.locate("#files").set_input_files(files)


def test_a_ros_map_is_read_as_the_command_line_reads_it(visit: Any, tmp_path: Path) -> None:
    """As PNG, which the browser decodes; `logic/map.test.js` reads the others."""
    visit.choose_empty_map()
    files = map_files(tmp_path, "a.png", png(drawing()))
    expected = load_ros_map(files[0])

    asked = visit.answer(
        lambda: open_files(visit, files),
        lambda asked: asked["cost_map"]["origin"] == pytest.approx(expected.origin),
    ).asked["cost_map"]

    np.testing.assert_array_equal(np.array(asked["data"][0]) >= 0.5, expected.occupancy >= 0.5)
    assert asked["resolution"] == expected.resolution
    expect(visit.locate("#scene-note")).to_contain_text("a.png: 5.0 × 4.0 m")
    expect(visit.locate("#sample")).to_have_value("own")


DROP = """(element, [name, text]) => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([text], name));
  const fire = (type) =>
    element.dispatchEvent(new DragEvent(type, { dataTransfer, bubbles: true, cancelable: true }));
  fire("dragover");
  const said = document.querySelector("#board").hasAttribute("data-drop");
  return [said, fire("drop"), document.querySelector("#board").hasAttribute("data-drop")];
}"""
"""Drop a file: was the board marked, would the browser open it, and does the mark stay."""


def test_notes_tell_of_files_that_are_chosen_or_dropped_and_of_a_copy(
    visit: Any, tmp_path: Path
) -> None:
    (tmp_path / "cut.png").write_bytes(png(drawing())[:60])
    (tmp_path / "a.txt").write_text("hello")
    note = visit.locate("#scene-note")

    open_files(visit, [tmp_path / "cut.png"])
    expect(note).to_have_text("cut.png: expected a PNG picture.")
    open_files(visit, [tmp_path / "a.txt"])
    expect(note).to_contain_text("a.txt: expected .json, .yaml with its picture")

    for where, name in (("#board", "a.json"), ("#bundle", "b.json")):
        outcome = visit.locate(where).evaluate(DROP, [name, '{"x_curr": [1, 2]}'])

        assert outcome == [True, False, False]
        expect(visit.locate("#scene-note")).to_contain_text(f"{name}: x_curr: expected 6 numbers")

    # A page that came over plain HTTP from another machine has no clipboard.
    visit.page.evaluate(
        "() => { navigator.clipboard.writeText = () => Promise.reject(new Error()); }"
    )
    visit.locate("#copy-curl").focus()

    visit.page.keyboard.press("Enter")

    expect(visit.locate("#scene-note")).to_have_text("Copied for curl.")
    expect(visit.locate("#copy-curl")).to_be_focused()


def test_a_robot_stops_when_a_map_is_opened(visit: Any, tmp_path: Path) -> None:
    files = map_files(tmp_path, "far.pgm", pgm(drawing()))
    files[0].write_text(files[0].read_text().replace("[-2.0, 1.5", "[100.0, 50.0"))
    visit.answer(lambda: visit.locate("#drive").click(), lambda asked: "warm_start" in asked)

    opened = visit.answer(
        lambda: open_files(visit, files), lambda asked: asked["cost_map"]["origin"][0] == 100
    )

    assert opened.status == 200
    assert opened.asked["x_curr"][0] > 100
    expect(visit.locate("#drive")).to_have_attribute("aria-pressed", "false")
    expect(visit.locate("#drive-note")).to_be_hidden()


def test_a_saved_scene_is_a_request_and_opens_again(visit: Any, tmp_path: Path) -> None:
    visit.locate("#num_samples").fill("8")
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


def test_a_scene_is_asked_of_the_bundle_that_it_names(
    open_page: Callable[..., Any], served_all: Any, tmp_path: Path
) -> None:
    visit = open_page(served_all.url)
    visit.wait_for_anchors()
    file = tmp_path / "scene.json"
    free = {"data": np.zeros((1, 50, 60)).tolist(), "resolution": 0.1}
    scene = {"cost_map": free, "x_curr": [-2, 0, 0, 0, 0, 0], "x_goal": [2, 0, 0, 0]}

    for model in ("flowmp-small-student", "v2x", "another"):
        file.write_text(json.dumps(scene | {"model": model, "robot_radius": 0.3}))
        asked = visit.answer(
            lambda: open_files(visit, [file]),
            lambda asked: np.shape(asked["cost_map"]["data"]) == (1, 50, 60),
        ).asked
        assert (asked["model"], asked["robot_radius"]) == ("flowmp-small-student", 0.3)

    expect(visit.locate("#bundle")).to_have_value("flowmp-small-student")
    expect(visit.locate("#scene-note")).to_have_text(
        "scene.json is open. Left out: model, as no another with a map is served."
    )
    assert visit.errors == []


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_copied_requests_run_and_give_the_same(
    visit: Any, copied: Callable[[Any, str], str]
) -> None:
    visit.locate("#num_samples").fill("4")
    shown = visit.answer(
        lambda: visit.locate("#refine-safety_margin").fill("0.15"),
        lambda asked: (asked["num_samples"], asked["refine"]["safety_margin"]) == (4, 0.15),
    ).answered

    paths = json.loads(printed_by("bash", copied(visit, "#copy-curl")))["trajectories"]
    np.testing.assert_allclose(paths, shown["trajectories"], atol=1e-6)

    program = f"""{copied(visit, "#copy-python")}
import json
print("JSON", anchors.trajectories.tolist())
"""
    said, _, paths = printed_by(sys.executable, program).rpartition("JSON ")
    assert f"{shown['safe'].count(True)} of 4 anchors are safe" in said
    np.testing.assert_allclose(json.loads(paths), shown["trajectories"], atol=1e-5)
