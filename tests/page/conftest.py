"""Headless Chromium and the real service: `anchorflow serve` on a port of this machine."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from image_planner import write_image_bundle

from anchorflow_benchmarks.programs import Program, free_port, running, serve_command
from anchorflow_client import JsonCodec, Payload
from anchorflow_client.contract import OCCUPIED
from anchorflow_client.oip_codec import PATH_OF_INPUT, RESERVED, OipCodec
from anchorflow_client.oip_message import nest, unpack_header, unpack_tensors
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.http.tokens import token_line

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, Request, Response

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
)
DESK: dict[str, Any] = {"viewport": {"width": 1440, "height": 900}}
# The service and the browser may share a core with other processes.
PATIENCE_S = 60
MAP_M = 9.6
"""Side of the sample maps, whose centre is (0, 0)."""

HEADER_LENGTH = "inference-header-content-length"

Point = tuple[float, float]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium from ANCHORFLOW_CHROMIUM or the path.

    The scope is a module, because Playwright keeps an event loop running in this thread, and other
    tests need their own.
    """
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = filter(
        None, (os.environ.get("ANCHORFLOW_CHROMIUM"), *map(shutil.which, CHROMIUM_NAMES))
    )
    executable = next(found, None)
    if executable is None:
        pytest.skip(f"no Chromium: none of {', '.join(CHROMIUM_NAMES)} is on the path")
    sync_api.expect.set_options(timeout=1e3 * PATIENCE_S)
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=[*CHROMIUM_FLAGS])
        yield browser
        browser.close()


@cache
def compiled() -> None:
    """Wait until all loops are on disk: a service that compiles them refuses some requests."""
    subprocess.run([sys.executable, "-m", "anchorflow_trajectory.warm_up"], check=True)


def serving(*options: str) -> Program:
    """Return a service in a process of its own, always on the same port."""
    compiled()
    return Program("service", serve_command("--port", free_port(), *options), says=" at ")


@pytest.fixture(scope="session")
def served() -> Iterator[Program]:
    """A service with the default bundle; a test that stops it starts it again."""
    with running(serving()) as served:
        yield served


@pytest.fixture(scope="session")
def served_all(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Program]:
    """A service with two planners with a map, and three without one."""
    camera = write_image_bundle(tmp_path_factory.mktemp("camera"))
    shipped = [DEFAULT_BUNDLE.parent / name for name in ("student", "v2x", "goalflow")]
    with running(serving(*bundle_options([DEFAULT_BUNDLE, camera, *shipped]))) as served:
        yield served


@pytest.fixture
def served_copies(tmp_path: Path) -> Iterator[tuple[Program, list[Path]]]:
    """A service with a map planner and a camera planner, in folders that a test may change."""
    camera = tmp_path / "camera"
    camera.mkdir()
    copies = [Path(shutil.copytree(DEFAULT_BUNDLE, tmp_path / "map")), write_image_bundle(camera)]
    with running(serving(*bundle_options(copies))) as served:
        yield served, copies


def bundle_options(folders: list[Path]) -> list[str]:
    """Options of `anchorflow serve`."""
    return [option for folder in folders for option in ("--bundle", str(folder))]


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Program]:
    """A service that requires the token "open sesame"."""
    (tmp_path / "tokens").write_text(token_line("visitor", ("infer",), "open sesame"))
    with running(serving("--tokens", str(tmp_path / "tokens"))) as guarded:
        yield guarded


class Visit:
    """An open page, with points of the map in metres and the responses of the service."""

    def __init__(self, page: Page, url: str) -> None:
        self.page = page
        self.url = url
        self.errors: list[str] = []
        """Errors in the console of the browser."""
        self.requests: list[Request] = []
        """Requests that have been answered."""
        page.on("requestfinished", lambda request: self.requests.append(request))  # noqa: PLW0108
        page.on("console", self._note)
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    def open(self) -> None:
        self.page.goto(self.url)

    def locate(self, selector: str) -> Any:
        return self.page.locator(selector)

    def at(self, point: Point) -> Point:
        """Convert a point in m to pixels of the window."""
        box = self.locate("#canvas").bounding_box()
        x, y = (value / MAP_M + 0.5 for value in point)
        return box["x"] + x * box["width"], box["y"] + (1 - y) * box["height"]

    def handle(self, name: str) -> Point:
        """Return the middle of a handle in pixels of the window."""
        box = self.locate(f"[data-handle={name}]").bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag(self, start: Point, end: Point, *, steps: int = 6) -> None:
        """Drag the pointer, in pixels of the window."""
        self.page.mouse.move(*start)
        self.page.mouse.down()
        self.page.mouse.move(*end, steps=steps)
        self.page.mouse.up()

    def drag_end(self, name: str, point: Point) -> None:
        """Drag the start or the goal to a point in m."""
        self.drag(self.handle(name), self.at(point))

    def answer(
        self, act: Callable[[], object], when: Callable[[Any], bool], *, to: str = "/anchors"
    ) -> Exchange:
        """Return the first exchange after `act` whose parsed request satisfies `when`."""

        def fits(response: Response) -> bool:
            return response.url.endswith(to) and when(asked_in(response))

        with self.page.expect_response(fits, timeout=1e3 * PATIENCE_S) as caught:
            act()
        return Exchange(caught.value)

    def choose_empty_map(self) -> Exchange:
        """Choose the empty map, with the goal straight to the right of the start."""
        self.locate("#sample").select_option("empty")
        self.drag_end("start", (-4.0, 0.0))
        return self.answer(
            lambda: self.drag_end("goal", (4.0, 0.0)),
            lambda asked: asked["x_goal"][:2] == pytest.approx([4.0, 0.0], abs=0.05),
        )

    def wait_for_anchors(self) -> None:
        """Wait for the first anchors; from then on the page can be used."""
        wait_for_text(self, "#summary", "anchors are safe")

    def choose_camera(self) -> None:
        """Choose the camera planner; return when its first anchors are on the page."""
        self.wait_for_anchors()
        self.locate("#bundle").select_option("tiny-camera")
        wait_for_text(self, "#summary", "No sample fits this planner")
        self.locate("#plan").click()
        wait_for_text(self, "#summary", "6 anchors")

    @staticmethod
    def occupied(asked: Any) -> np.ndarray:
        """Return [H,W] bool, the obstacles in a request's map."""
        return np.array(asked["cost_map"]["data"][0]) >= OCCUPIED

    def forget_errors(self, *reasons: str) -> None:
        """Forget errors that the test has provoked; the browser logs each status but 200."""
        left = [error for error in self.errors if not any(each in error for each in reasons)]
        assert len(left) < len(self.errors)
        self.errors[:] = left

    def keep(self, name: str, *, full_page: bool = False) -> None:
        """Write a screenshot to look at into ANCHORFLOW_ARTEFACTS, if that names a folder."""
        if folder := os.environ.get("ANCHORFLOW_ARTEFACTS"):
            self.page.screenshot(path=Path(folder) / name, full_page=full_page)

    def picture(self) -> bytes:
        """Return a screenshot of the map."""
        return self.locate("#board").screenshot()

    def wait_for_another_picture(self, before: bytes) -> None:
        """Wait until the map looks different."""
        for _ in range(10 * PATIENCE_S):
            if self.picture() != before:
                return
            self.page.wait_for_timeout(100)
        pytest.fail("the picture has not changed")

    def _note(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.errors.append(f"{message.text} ({message.location['url']})")


class Exchange:
    """A request to the service and its response, both in the contract's JSON."""

    def __init__(self, response: Response) -> None:
        self.status = response.status
        self.asked = asked_in(response)
        self.answered = answered_in(response)


def asked_in(response: Response) -> Any:
    """Parse the request of a response, valid or not."""
    request = response.request
    length = request.headers.get(HEADER_LENGTH)
    if length is None:
        return request.post_data_json
    header, data = unpack_header(Payload(request.post_data_buffer or b"", int(length)))
    tensors = unpack_tensors(header["inputs"], data, "inputs", RESERVED)
    leaves = {PATH_OF_INPUT.get(name, name): tensor.tolist() for name, tensor in tensors.items()}
    *leaves["cost_map.origin"], leaves["cost_map.resolution"] = leaves.pop("map_geometry")
    leaves |= header["parameters"]
    del leaves["binary_data_output"]
    return nest(leaves)


def answered_in(response: Response) -> Any:
    """Parse a response."""
    length = response.headers.get(HEADER_LENGTH)
    if length is None:
        return response.json()
    batch = OipCodec().decode_answer(Payload(response.body(), int(length)))
    return json.loads(JsonCodec().encode_answer(batch).body)


def new_context(browser: Browser, **options: Any) -> BrowserContext:
    context = browser.new_context(**DESK | options)
    context.set_default_timeout(1e3 * PATIENCE_S)
    return context


@pytest.fixture(scope="module")
def desk(browser: Browser) -> Iterator[BrowserContext]:
    """A context on a desktop, whose pages share files but no session."""
    context = new_context(browser)
    yield context
    context.close()


@pytest.fixture
def open_page(
    browser: Browser, desk: BrowserContext, served: Program
) -> Iterator[Callable[..., Visit]]:
    """Open the page on the desktop, or in a context of its own, with options of Playwright."""
    opened: list[Page | BrowserContext] = []

    def open_with(
        url: str = served.url, *, at_once: bool = True, own: bool = False, **options: Any
    ) -> Visit:
        context = new_context(browser, **options) if own or options else desk
        page = context.new_page()
        opened.append(page if context is desk else context)
        visit = Visit(page, url)
        if at_once:
            visit.open()
        return visit

    yield open_with
    for each in opened:
        each.close()
    desk.clear_permissions()


@pytest.fixture
def camera(open_page: Callable[..., Visit], served_all: Program) -> Iterator[Visit]:
    """The page with the camera planner chosen and its first anchors."""
    visit = open_page(served_all.url)
    visit.choose_camera()
    yield visit
    assert visit.errors == []


@pytest.fixture
def copied() -> Callable[[Visit, str], str]:
    """Press a button and return the text that it copies."""

    def copy(visit: Visit, button: str) -> str:
        visit.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        visit.locate("#scene-note").evaluate("note => { note.textContent = ''; }")
        visit.locate(button).click()
        wait_for_text(visit, "#scene-note", "Copied for")
        return visit.page.evaluate("navigator.clipboard.readText()")

    return copy


@pytest.fixture
def visit(open_page: Callable[..., Visit]) -> Iterator[Visit]:
    """The page on a desktop with its first anchors; errors in the console fail the test."""
    visit = open_page()
    visit.wait_for_anchors()
    yield visit
    assert visit.errors == []


def wait_for_text(visit: Visit, selector: str, text: str) -> None:
    """Wait until an element shows a text."""
    from chromium import expect

    expect(visit.locate(selector)).to_contain_text(text)
