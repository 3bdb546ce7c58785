"""V2X-VLM: pictures of any size, one of them optional, and one anchor."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import expect
from PIL import Image

CAR, ROADSIDE = "#input-vehicle_image", "#input-infrastructure_image"
PROMPT = "The ego vehicle drives at 7.4 m/s. Plan its path for 4.5 seconds."


@pytest.fixture
def visit(open_page: Callable[..., Any], served_all: Any) -> Iterator[Any]:
    """The page with V2X-VLM, without its sample, after the first anchors of another bundle."""
    visit = open_page(served_all.url)
    visit.page.route("**/page/samples/*", lambda route: route.fulfill(body=""))
    visit.wait_for_anchors()
    visit.locate("#bundle").select_option("v2x")
    yield visit
    assert visit.errors == []


def picture(folder: Path, name: str, *, width: int, height: int) -> Path:
    """Write a picture from dark to light."""
    levels = np.linspace(0, 255, width * height).astype(np.uint8).reshape(height, width)
    Image.fromarray(levels).convert("RGB").save(folder / name)
    return folder / name


def choose(visit: Any, field: str, file: Path) -> None:
    visit.locate(field).set_input_files(file)
    expect(visit.locate(f".picture:has({field}) .hint")).to_contain_text("pixels")


def plan(visit: Any) -> Any:
    """Press Plan and return the exchange."""
    return visit.answer(lambda: visit.locate("#plan").click(), lambda asked: "inputs" in asked)


def test_nothing_is_asked_before_there_is_a_picture(visit: Any) -> None:
    summary = visit.locate("#summary")
    expect(summary).to_contain_text("No sample fits this planner")
    # The figures of the bundle before are gone, too.
    expect(visit.locate("#best tbody tr")).to_have_count(0)
    expect(visit.locate("#anchor-figures")).to_be_empty()

    visit.locate("#plan").click()
    expect(summary).to_have_text("Not asked. vehicle_image: expected a picture, got none.")
    expect(visit.locate("#inputs .wrong:visible")).to_have_text("expected a picture, got none")

    asked = [request.post_data_buffer for request in visit.requests if request.method == "POST"]
    assert not [body for body in asked if b"vehicle_image" in body]


def test_a_picture_goes_in_its_own_size_and_an_optional_one_when_it_is_given(
    visit: Any, tmp_path: Path
) -> None:
    car = picture(tmp_path, "car.png", width=90, height=50)
    pole = picture(tmp_path, "pole.jpg", width=64, height=80)
    expect(visit.locate(".input").nth(1)).to_contain_text("uint8 [3, HI, WI], optional")
    visit.locate("#input-prompt").fill(PROMPT)
    choose(visit, CAR, car)
    expect(visit.locate("#summary")).to_have_text("Press Plan to ask.")

    alone = plan(visit)

    told = {"vehicle_image": {"png": base64.b64encode(car.read_bytes()).decode()}, "prompt": PROMPT}
    assert alone.asked["inputs"] == told
    assert alone.status == 200
    assert alone.answered["absent_inputs"] == "infrastructure_image"

    choose(visit, ROADSIDE, pole)
    both = plan(visit)

    jpeg = base64.b64encode(pole.read_bytes()).decode()
    assert both.asked["inputs"] == {**told, "infrastructure_image": {"jpeg": jpeg}}
    assert both.status == 200
    visit.keep("v2x.png")

    visit.locate(".picture button:visible").click()
    expect(visit.locate(".thumbnail:visible")).to_have_count(1)
    assert plan(visit).asked["inputs"] == told


def test_a_transparent_picture_is_sent_as_it_is_shown(visit: Any, tmp_path: Path) -> None:
    pixels = np.full((10, 20, 4), (200, 100, 50, 255), np.uint8)
    pixels[:, 10:, 3] = 0
    Image.fromarray(pixels).save(tmp_path / "glass.png")
    choose(visit, CAR, tmp_path / "glass.png")
    note = visit.locate(f".picture:has({CAR}) .hint")
    expect(note).to_have_text("20 × 10 pixels, drawn on black")

    told = plan(visit)

    (sent,) = told.asked["inputs"]["vehicle_image"].values()
    read = np.asarray(Image.open(io.BytesIO(base64.b64decode(sent))).convert("RGB"))
    np.testing.assert_array_equal(read, pixels[..., :3] * (pixels[..., 3:] // 255))


def test_of_two_pictures_the_later_one_counts(visit: Any, tmp_path: Path) -> None:
    slow = picture(tmp_path, "slow.png", width=30, height=20)
    quick = picture(tmp_path, "quick.png", width=90, height=50)
    visit.page.evaluate(
        """() => {
            const read = createImageBitmap;
            window.createImageBitmap = async (file) => {
                if (file.name === "slow.png") await new Promise((go) => setTimeout(go, 500));
                return read(file);
            };
        }"""
    )
    visit.locate(CAR).set_input_files(slow)
    choose(visit, CAR, quick)
    visit.page.wait_for_timeout(700)

    expect(visit.locate(f".picture:has({CAR}) .hint")).to_have_text("90 × 50 pixels")
    sent = plan(visit).asked["inputs"]["vehicle_image"]
    assert sent == {"png": base64.b64encode(quick.read_bytes()).decode()}


def test_one_anchor_is_told_as_one(visit: Any, tmp_path: Path) -> None:
    choose(visit, CAR, picture(tmp_path, "car.png", width=20, height=10))
    visit.locate("#input-prompt").fill(PROMPT)
    assert plan(visit).status == 200

    expect(visit.locate("#summary")).to_have_text("1 anchor, in gold.")
    expect(visit.locate("#bundle-hint")).to_have_text("What answers: 45 poses up to 4.5 s.")
    expect(visit.locate("#best-name")).to_have_text("The anchor")
    expect(visit.locate("#num_samples")).to_be_hidden()
    expect(visit.locate("#num_samples-value")).to_have_text("1")
    expect(visit.locate("#poses tbody tr").last).to_contain_text("4.50")
    expect(visit.locate("#anchor-figures")).to_have_text("4.5 s")
