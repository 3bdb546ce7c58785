"""A planner with a camera: its card, its inputs, and its anchors from above."""

from __future__ import annotations

import base64
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
from image_planner import HEIGHT, TIMES, WIDTH, expected
from PIL import Image

from anchorflow_client.contract.inputs import read_inputs

MAP_TOOLS = ("#canvas", "#board", "#brush", "#sample", "[data-handle=goal]", "#triangle")
MAP_ACTS = ("#drive", "#replay", "#open", "#save", "#sampler-method", "#robot_radius", "#charts")
REFUSED = "status of 422"
CARD_WITH_MORE = [
    {"name": "prompt", "dtype": "text", "shape": ["B"], "unit": "", "range": None},
    {"name": "lidar", "dtype": "float32", "shape": ["B", 1, 9, 9], "unit": "", "range": [0.25, 1]},
]


def picture(folder: Path, *, width: int = WIDTH, height: int = HEIGHT) -> Path:
    """Write a PNG file, red from left to right, green from top to bottom."""
    row, column = np.mgrid[:height, :width]
    red, green = 255 * column // width, 255 * row // height
    pixels = np.stack([red, green, np.full_like(red, 90)], -1).astype(np.uint8)
    file = folder / f"{width}x{height}.png"
    Image.fromarray(pixels).save(file)
    return file


def pixels_of(sent: dict[str, str]) -> np.ndarray:
    """Return [3,H,W] of an image in a request."""
    (data,) = sent.values()
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")).transpose(
        2, 0, 1
    )


def plan(visit: Any) -> Any:
    """Press Plan and return the exchange."""
    return visit.answer(lambda: visit.locate("#plan").click(), lambda asked: "inputs" in asked)


def fill_in(visit: Any, file: Path, status: str) -> None:
    visit.locate("#input-camera").set_input_files(file)
    expect(visit.locate(".picture .hint")).to_contain_text("pixels")
    visit.locate("#input-ego_status").fill(status)


def test_it_shows_the_card_a_field_for_every_input_and_no_tools_of_the_map(camera: Any) -> None:
    fields = camera.locate("#inputs .input")

    expect(fields).to_have_count(2)
    expect(fields.nth(0)).to_contain_text("uint8 [3, 16, 24]")
    expect(camera.locate("#input-camera")).to_have_attribute("type", "file")
    expect(fields.nth(1)).to_contain_text("float32 [4]")
    expect(fields.nth(1)).to_contain_text("m/s, m/s, m/s^2, m/s^2, −60 to 60")
    expect(camera.locate("#card-state")).to_have_text("ready")
    for text in (
        "tiny-camera 1.0.0",
        "camera uint8 [B, 3, 16, 24]",
        "vocabulary: size 6",
        "8 poses from 0.5 to 4 s, 0.5 s apart",
        "trajectories [N, T, 3] of x, y, heading, scores",
        "bev_semantics float32 [B, 3, 16, 24], 0 to 1",
    ):
        expect(camera.locate("#card")).to_contain_text(text)
    for tool in (*MAP_TOOLS, *MAP_ACTS):
        expect(camera.locate(tool)).to_be_hidden()
    camera.page.keyboard.press("Control+z")
    assert "cost_map" not in plan(camera).asked

    camera.answer(
        lambda: camera.locate("#bundle").select_option("flowmp-small"),
        lambda asked: "cost_map" in asked,
    )
    expect(camera.locate("#summary")).to_contain_text("anchors are safe")
    expect(camera.locate("#link-text")).to_contain_text("flowmp-small")
    for tool in MAP_TOOLS:
        expect(camera.locate(tool)).to_be_visible()
    for tool in ("#birds-eye", "#inputs", "#plan", "#poses", "#raster-block"):
        expect(camera.locate(tool)).to_be_hidden()


def test_it_plans_with_what_was_filled_in_and_draws_what_comes(camera: Any, tmp_path: Path) -> None:
    file = picture(tmp_path)
    fill_in(camera, file, "8, 0.5 0;0")
    expect(camera.locate("#summary")).to_have_text("What is asked has changed: plan again.")

    told = plan(camera)

    assert told.asked["inputs"] == {
        "camera": {"png": base64.b64encode(file.read_bytes()).decode()},
        "ego_status": [8, 0.5, 0, 0],
    }
    assert told.asked["num_samples"] == 6
    assert told.asked["outputs"] == ["bev_semantics"]
    sent = pixels_of(told.asked["inputs"]["camera"])
    paths, scores = expected(sent.mean() / 255, 8.0)
    np.testing.assert_allclose(told.answered["trajectories"], paths, atol=1e-5)
    expect(camera.locate("#summary")).to_contain_text("6 anchors")
    expect(camera.locate("#best tbody tr")).to_have_count(6)
    expect(camera.locate("#best tbody tr").first).to_contain_text(
        f"{scores[0]:.2f}".replace("-", "−")
    )
    rows = camera.locate("#poses tbody tr").all_inner_texts()
    read = np.array([row.replace("−", "-").split() for row in rows], float)
    np.testing.assert_allclose(read, np.column_stack([TIMES, paths[0]]), atol=0.005001)
    expect(camera.locate("#anchor-figures")).to_contain_text(f"{TIMES[-1]:.1f} s")
    camera.keep("camera.png")

    expect(camera.locate("#raster-note")).to_contain_text("does not say how many metres")
    shown = camera.locate("#raster").evaluate(
        "canvas => Array.from(canvas.getContext('2d')"
        ".getImageData(0, 0, canvas.width, canvas.height).data)"
    )
    rgb = np.array(shown).reshape(HEIGHT, WIDTH, 4)[..., :3].transpose(2, 0, 1)
    assert np.abs(rgb - sent.astype(int)).max() <= 1

    box = camera.locate("#birds-eye").bounding_box()
    met: list[int] = []
    for left in range(4, int(box["width"]) - 4, 4):
        camera.page.mouse.move(box["x"] + left, box["y"] + 0.2 * box["height"])
        name = camera.locate("#anchor-name").inner_text()
        if name != "Best anchor" and int(name.split()[1]) not in met:
            met.append(int(name.split()[1]))
    # From left to right is from the greatest y to the smallest.
    assert met == np.argsort(-paths[:, -1, 1]).tolist()


def test_a_picture_of_another_size_is_drawn_to_the_cards_and_another_file_is_not_sent(
    camera: Any, tmp_path: Path
) -> None:
    fill_in(camera, picture(tmp_path, width=480, height=320), "1, 0, 0, 0")
    expect(camera.locate(".picture .hint")).to_have_text("480 × 320 pixels, drawn to 24 × 16")

    told = plan(camera)

    assert told.status == 200
    sent = pixels_of(told.asked["inputs"]["camera"])
    assert sent.shape == (3, HEIGHT, WIDTH)
    small = pixels_of({"png": base64.b64encode(picture(tmp_path).read_bytes()).decode()})
    assert np.abs(sent.astype(int) - small).max() < 16
    (tmp_path / "notes.png").write_text("no picture")
    camera.locate("#input-camera").set_input_files(tmp_path / "notes.png")
    note = camera.locate(".picture .hint")
    expect(note).to_have_text("notes.png: expected a PNG or JPEG picture.")
    assert not pixels_of(plan(camera).asked["inputs"]["camera"]).any()


def test_fewer_anchors_are_the_best_ones_and_extras_are_a_choice(camera: Any) -> None:
    camera.locate("#num_samples").fill("2")
    camera.locate("#seed").fill("5")
    camera.page.keyboard.press("Tab")
    expect(camera.locate("#poses")).to_have_css("opacity", "0.4")
    camera.locate("#outputs input[value=goals]").check()
    camera.locate("#outputs input[value=bev_semantics]").uncheck()

    told = plan(camera)

    names = ("num_samples", "seed", "outputs")
    assert [told.asked[name] for name in names] == [2, 5, ["goals"]]
    np.testing.assert_allclose(told.answered["trajectories"], expected(0.0, 0.0)[0][:2], atol=1e-6)
    expect(camera.locate("#best tbody tr")).to_have_count(2)
    expect(camera.locate("#poses")).to_have_css("opacity", "1")
    expect(camera.locate("#extras")).to_contain_text("goals [2, 2]")
    expect(camera.locate("#raster-block")).to_be_hidden()


def test_a_refused_input_is_explained_beside_it(camera: Any) -> None:
    field = camera.locate("#inputs .input").nth(1)
    camera.locate("#input-ego_status").fill("61, 0, 0, 0")

    refused = plan(camera)

    assert refused.status == 422
    expect(field.locator(".wrong")).to_have_text(refused.answered["error"]["message"])
    camera.forget_errors(REFUSED)
    asked = len(camera.requests)
    camera.locate("#input-ego_status").fill("1, 2, three")
    expect(field.locator(".wrong")).to_be_hidden()
    camera.locate("#plan").click()
    expect(field.locator(".wrong")).to_have_text("expected numbers, got three")
    camera.locate("#input-ego_status").fill("1, 2")
    camera.locate("#plan").click()
    expect(field.locator(".wrong")).to_have_text("expected 4 numbers, got 2")
    sent = [request.url for request in camera.requests[asked:]]
    assert not [url for url in sent if url.endswith("/anchors")]


def test_a_robot_stops_where_another_planner_is_chosen(
    open_page: Callable[..., Any], served_all: Any
) -> None:
    visit = open_page(served_all.url)
    visit.wait_for_anchors()
    visit.locate("#num_samples").fill("4")
    visit.answer(lambda: visit.locate("#drive").click(), lambda asked: asked["num_samples"] == 4)

    visit.choose_camera()
    asked = len(visit.requests)
    visit.page.wait_for_timeout(500)

    later = [request.url for request in visit.requests[asked:]]
    assert not [url for url in later if url.endswith("/anchors")]
    expect(visit.locate("#drive")).to_have_attribute("aria-pressed", "false")
    assert visit.errors == []


def test_new_versions_of_the_chosen_bundle_are_taken_up(
    open_page: Callable[..., Any], served_copies: Any
) -> None:
    """Loaded by the service for a map and for a camera planner, and by a service that restarts."""
    served, bundles = served_copies
    visit = open_page(served.url)
    for number, version, restarted in ((0, "9.9.7", False), (1, "9.9.8", False), (1, "9.9", True)):
        file = bundles[number] / "manifest.json"
        manifest = json.loads(file.read_text())
        name = manifest["name"]
        visit.locate("#bundle").select_option(name)
        expect(visit.locate("#link-text")).to_contain_text(name)
        if number:
            visit.locate("#plan").click()
        expect(visit.locate("#summary")).to_contain_text("anchors")
        file.write_text(json.dumps({**manifest, "version": version}))

        if restarted:
            served.stop()
            expect(visit.locate("#banner")).to_be_visible()
            served.start()
        else:
            load = f"{served.url}/v2/repository/models/{name}/load"
            assert visit.page.request.post(load, data={}).ok
            visit.locate("#reseed").click()
            if number:
                visit.locate("#plan").click()

        expect(visit.locate("#link-text")).to_have_text(f"{name} {version}")
        expect(visit.locate("#card dd").first).to_have_text(f"{name} {version}")
        expect(visit.locate("#bundle")).to_have_value(name)


@pytest.fixture
def patched(open_page: Callable[..., Any], served_all: Any) -> Callable[..., Any]:
    """Open the page with a changed card of the camera planner, which is the first in the list."""

    def open_with(change: Callable[[dict[str, Any]], None]) -> Any:
        visit = open_page(served_all.url, at_once=False)

        def answer(route: Any) -> None:
            told = route.fetch()
            models = {card["name"]: card for card in told.json()["models"]}
            change(models["tiny-camera"])
            route.fulfill(response=told, json={"models": [models["tiny-camera"]]})

        visit.page.route("**/v2/models", answer)
        visit.open()
        return visit

    return open_with


def test_texts_and_tensors_have_fields_too(patched: Callable[..., Any]) -> None:
    visit = patched(lambda card: card["inputs"].extend(CARD_WITH_MORE))
    expect(visit.locate("#inputs .input")).to_have_count(4)
    visit.locate("#input-prompt").fill('Turn "left" at the café\n')

    with_text = visit.answer(
        lambda: visit.locate("#plan").click(), lambda asked: asked.get("inputs", {}).get("prompt")
    )
    inputs = with_text.asked["inputs"]

    assert inputs["prompt"] == 'Turn "left" at the café\n'
    read = read_inputs(inputs)["lidar"]
    np.testing.assert_array_equal(read, np.full((1, 9, 9), 0.25, np.float32))  # type: ignore[arg-type]
    visit.locate("#input-lidar").fill("[[[1, 2")
    visit.locate("#plan").click()
    expect(visit.locate("#inputs .input").nth(3).locator(".wrong")).to_contain_text("expected JSON")
    visit.locate("#input-lidar").fill("[[[1, 2]]]")
    assert plan(visit).asked["inputs"]["lidar"] == [[[1, 2]]]


def test_plan_may_be_pressed_while_the_page_looks_for_a_sample(
    open_page: Callable[..., Any], served_all: Any
) -> None:
    visit = open_page(served_all.url)
    visit.wait_for_anchors()
    held: list[Any] = []
    visit.page.route("**/page/samples/*.json", lambda route: held.append(route), times=1)  # noqa: PLW0108
    visit.locate("#bundle").select_option("tiny-camera")
    visit.locate("#plan").click()
    expect(visit.locate("#summary")).to_contain_text("6 anchors")

    with visit.page.expect_response("**/page/samples/crossing.json"):
        held.pop().continue_()
    visit.page.wait_for_timeout(300)

    expect(visit.locate("#summary")).to_contain_text("6 anchors")


def test_a_picture_of_known_extent_lies_under_the_anchors(patched: Callable[..., Any]) -> None:
    def place(card: dict[str, Any]) -> None:
        card["answer"]["extras"][1]["extent"] = [0, 10, -4, 4]

    visit = patched(place)
    visit.locate("#plan").click()
    expect(visit.locate("#summary")).to_contain_text("6 anchors")
    expect(visit.locate("#raster-block")).to_be_hidden()
    with_picture = visit.locate("#birds-eye").screenshot()

    visit.locate("#outputs input[value=bev_semantics]").uncheck()
    plan(visit)

    expect(visit.locate("#summary")).to_contain_text("6 anchors")
    colours = [
        np.asarray(Image.open(io.BytesIO(shot)).convert("L"), int)
        for shot in (with_picture, visit.locate("#birds-eye").screenshot())
    ]
    # A place ahead of the ego without anchors; it is as black as the image that is not filled in.
    height, width = colours[0].shape
    assert colours[0][height // 3, width // 2 + 30] < colours[1][height // 3, width // 2 + 30] - 60


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_copied_requests_run_and_give_the_same(
    camera: Any, copied: Callable[[Any, str], str], tmp_path: Path
) -> None:
    fill_in(camera, picture(tmp_path), "3, 0, 0, 0")
    shown = plan(camera).answered

    told = json.loads(printed_by("bash", copied(camera, "#copy-curl")))
    assert told["trajectories"] == shown["trajectories"]
    assert told["bev_semantics"] == shown["bev_semantics"]

    program = f"""{copied(camera, "#copy-python")}
import json
print("JSON", anchors.trajectories.tolist())
"""
    paths = json.loads(printed_by(sys.executable, program).rpartition("JSON ")[2])
    np.testing.assert_allclose(paths, shown["trajectories"], atol=1e-5)
