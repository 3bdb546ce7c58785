"""A recorded drive on the page: its slider fills in the inputs of a frame and shows the anchors."""

from __future__ import annotations

import base64
import copy
import io
import json
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import expect
from driven_bend import bend
from PIL import Image

from anchorflow_client.contract.inputs import read_inputs
from anchorflow_driving.drive_file import drive_file, windows_on_the_way
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle

GOALFLOW = DEFAULT_BUNDLE.parent / "goalflow"


@pytest.fixture(scope="session")
def drive() -> dict[str, Any]:
    """Frames 0.5 s apart in a bend to the left, then in one to the right."""
    card = load_bundle(GOALFLOW).card
    logs = [windows_on_the_way(bend(number)) for number in (0, 1)]
    (about, left), (_, right) = (drive_file(log, card.inputs, of=card.name) for log in logs)
    frames = [*left, *right]
    return {**about, "frames": [{**each, "time_s": 2 + k / 2} for k, each in enumerate(frames)]}


@pytest.fixture
def driving(open_page: Callable[..., Any], served_all: Any) -> Iterator[Any]:
    """The page with GoalFlow and its first anchors."""
    visit = open_page(served_all.url)
    visit.wait_for_anchors()
    visit.locate("#bundle").select_option("goalflow")
    expect(visit.locate("#summary")).to_contain_text("64 anchors,")
    yield visit
    assert visit.errors == []


def opened(visit: Any, drive: dict[str, Any], folder: Path) -> Any:
    """Open a drive; return the first exchange about it."""
    file = folder / "drive.json"
    file.write_text(json.dumps(drive))
    return visit.answer(
        lambda: visit.locate("#drive-file").set_input_files(file), asks_about(drive["frames"][0])
    )


def asks_about(frame: dict[str, Any]) -> Callable[[Any], bool]:
    return lambda asked: asked["inputs"].get("ego_status") == frame["inputs"]["ego_status"]


def sent(exchange: Any) -> np.ndarray:
    return np.asarray(read_inputs(exchange.asked["inputs"])["bev"])


def drawn(frame: dict[str, Any]) -> np.ndarray:
    packed = frame["inputs"]["bev"]
    data = zlib.decompress(base64.b64decode(packed["zlib"]))
    return np.frombuffer(data, packed["dtype"]).reshape(packed["shape"])


def test_keys_slider_and_play_button_ask_about_their_time_and_draw_the_answer(
    driving: Any, drive: dict[str, Any], tmp_path: Path
) -> None:
    first = opened(driving, drive, tmp_path)
    frames = drive["frames"]
    np.testing.assert_array_equal(sent(first), drawn(frames[0]))
    expect(driving.locate("#drive-text")).to_have_text("2.0 s")
    # The route is drawn on the street, and is not a picture beside it.
    expect(driving.locate("#drive-route")).to_be_visible()
    expect(driving.locate("#sensed figcaption")).to_have_text(["bev"])
    expect(driving.locate("#poses tbody")).to_have_text(best_poses(first))
    driving.answer(lambda: driving.page.keyboard.press("ArrowRight"), asks_about(frames[1]))
    driving.answer(lambda: driving.page.keyboard.press("ArrowLeft"), asks_about(frames[0]))
    expect(driving.locate("#poses tbody")).to_have_text(best_poses(first))
    before = driving.locate("#birds-eye").screenshot()

    last = driving.answer(
        lambda: driving.locate("#drive-time").fill(str(len(frames) - 1)), asks_about(frames[-1])
    )

    assert last.status == 200
    np.testing.assert_array_equal(sent(last), drawn(frames[-1]))
    assert last.asked["inputs"]["vehicle_size"] == frames[-1]["inputs"]["vehicle_size"]
    assert last.answered["trajectories"] != first.answered["trajectories"]
    expect(driving.locate("#drive-text")).to_have_text(f"{frames[-1]['time_s']:.1f} s")
    expect(driving.locate("#poses tbody")).to_have_text(best_poses(last))
    assert best_poses(last) != best_poses(first)
    assert driving.locate("#birds-eye").screenshot() != before
    shown = driving.locate("#input-ego_status").input_value().split(", ")
    assert [*map(float, shown)] == frames[-1]["inputs"]["ego_status"]
    driving.keep("drive.png")

    driving.answer(lambda: driving.locate("#drive-time").fill("0"), asks_about(frames[0]))
    driving.answer(lambda: driving.locate("#drive-play").click(), asks_about(frames[-1]))
    play = driving.locate("#drive-play")
    expect(play).to_have_attribute("aria-pressed", "false")
    expect(driving.locate("#drive-time")).to_have_value(str(len(frames) - 1))


def test_while_the_slider_is_dragged_the_newest_wins_and_a_closed_drive_leaves_its_inputs(
    driving: Any, drive: dict[str, Any], tmp_path: Path
) -> None:
    assert "route" in opened(driving, drive, tmp_path).asked["inputs"]
    frames = drive["frames"]
    driving.page.evaluate("performance.clearResourceTimings()")
    moves = 40
    drag = """([moves, last]) => {
        const slider = document.getElementById("drive-time");
        for (let k = 1; k <= moves; k++) {
            slider.value = k === moves ? last : k % (last + 1);
            slider.dispatchEvent(new Event("input"));
        }
    }"""

    driving.answer(
        lambda: driving.page.evaluate(drag, [moves, len(frames) - 1]), asks_about(frames[-1])
    )

    driving.page.wait_for_timeout(500)
    asked = "performance.getEntriesByType('resource').filter(e => e.name.endsWith('/anchors'))"
    assert driving.page.evaluate(f"{asked}.length") <= 3

    told = driving.answer(
        lambda: driving.locate("#close-drive").click(), lambda asked: "inputs" in asked
    )

    expect(driving.locate("#drive-bar")).to_be_hidden()
    expect(driving.locate("#sensed")).to_be_hidden()
    np.testing.assert_array_equal(sent(told), drawn(frames[-1]))
    expect(driving.locate("#summary")).to_contain_text("64 anchors")
    route = driving.locate("#input-route")
    route.fill("[[1, 2]]")
    route.fill("")
    expect(route).to_have_attribute("placeholder", "left out")
    told = driving.answer(
        lambda: driving.locate("#plan").click(), lambda asked: "route" not in asked["inputs"]
    )
    assert told.status == 200


def test_a_drive_that_does_not_fit_is_broken_or_is_another_planners_is_refused(
    driving: Any, drive: dict[str, Any], tmp_path: Path
) -> None:
    bev, *others = drive["inputs"]
    other = {**drive, "inputs": [{**bev, "shape": [20, 96, 64]}, *others]}
    (tmp_path / "other.json").write_text(json.dumps(other))
    broken = copy.deepcopy(drive)
    broken["frames"][0]["inputs"]["bev"]["zlib"] = "AAAA"
    (tmp_path / "cut.json").write_text(json.dumps(broken))
    trouble = driving.locate("#drive-trouble")

    driving.locate("#drive-file").set_input_files(tmp_path / "other.json")
    expect(trouble).to_have_text(
        "bev: expected uint8 [20, 192, 128], the drive has uint8 [20, 96, 64]; "
        "it was made for goalflow."
    )
    beside = driving.locate("#inputs .input").first.locator(".wrong")
    expect(beside).to_contain_text("bev: expected uint8 [20, 192, 128]")
    driving.locate("#drive-file").set_input_files(tmp_path / "cut.json")
    expect(trouble).to_have_text("cut.json: frame 0: bev: expected deflated bytes in base64.")

    expect(driving.locate("#drive-bar")).to_be_hidden()

    opened(driving, drive, tmp_path)
    why = "camera: the drive has no such input; it was made for goalflow, with bev, ego_status"

    driving.locate("#bundle").select_option("tiny-camera")

    expect(trouble).to_contain_text(why)
    expect(driving.locate("#drive-bar")).to_be_hidden()
    expect(driving.locate("#sensed")).to_be_hidden()
    expect(driving.locate("#summary")).to_contain_text("No sample fits this planner")
    driving.locate("#seed").fill("7")
    driving.page.keyboard.press("Tab")
    driving.answer(lambda: driving.locate("#plan").click(), lambda asked: asked["seed"] == 7)
    expect(trouble).to_be_hidden()


def test_a_picture_of_a_drive_goes_as_it_is(visit: Any) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (3, 6, 9), dtype=np.uint8)
    tensor = {
        "dtype": "uint8",
        "shape": [3, 6, 9],
        "base64": base64.b64encode(pixels.tobytes()).decode(),
    }
    fill = """async (tensor) => {
        const { ImageField } = await import("/page/js/tensors/image_field.js");
        const spec = { name: "camera", dtype: "uint8", shape: ["B", 3, 6, 9], range: null };
        const field = new ImageField(spec, "camera", () => {});
        field.fill(tensor);
        return field.value();
    }"""

    value = visit.page.evaluate(fill, tensor)

    read = np.asarray(Image.open(io.BytesIO(base64.b64decode(value["png"]))).convert("RGB"))
    np.testing.assert_array_equal(read.transpose(2, 0, 1), pixels)


def best_poses(exchange: Any) -> str:
    """The text of the table with the poses of the best anchor."""
    best = int(np.argmax(exchange.answered["scores"]))
    rows = [(0.5 * k, *pose) for k, pose in enumerate(exchange.answered["trajectories"][best], 1)]
    return "".join(f"{value:.2f}" for row in rows for value in row).replace("-", "−")
