"""Headless Chromium in front of the real service: `anchorflow serve` on a port of this machine."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from image_planner import write_image_bundle

from anchorflow_client import JsonCodec, Payload
from anchorflow_client.contract import OCCUPIED
from anchorflow_client.oip_codec import PATH_OF_INPUT, RESERVED, OipCodec
from anchorflow_client.oip_message import nest, unpack_header, unpack_tensors
from anchorflow_service.bundle import DEFAULT_BUNDLE

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Page, Request, Response

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
)
# The service and the browser may share a core with other tests.
PATIENCE_S = 60
MAP_M = 9.6
"""Side of the sample maps, which are centred on (0, 0)."""
SERVE = "import sys; from anchorflow_cli.main import main; main(['serve', *sys.argv[1:]])"

HEADER_LENGTH = "inference-header-content-length"

Point = tuple[float, float]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium of the system, in ANCHORFLOW_CHROMIUM or on the path.

    For a module only: while it is open, an event loop runs in this thread and no test may make
    another.
    """
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = filter(
        None, (os.environ.get("ANCHORFLOW_CHROMIUM"), *map(shutil.which, CHROMIUM_NAMES))
    )
    executable = next(found, None)
    if executable is None:
        pytest.skip(f"no Chromium: none of {', '.join(CHROMIUM_NAMES)} is on the path")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=[*CHROMIUM_FLAGS])
        yield browser
        browser.close()


class Served:
    """The service with its default bundle in a process of its own, always on the same port."""

    def __init__(self, *options: str) -> None:
        self._options = options
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Returns when it listens, at once where it does."""
        if self._process is not None:
            return
        self._process = subprocess.Popen(
            [sys.executable, "-u", "-c", SERVE, "--port", str(self.port), *self._options],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        assert self.url in self._process.stdout.readline()

    def stop(self) -> None:
        """As Ctrl+C does; returns when it is gone."""
        if self._process is None:
            return
        with self._process:
            self._process.send_signal(signal.SIGINT)
        self._process = None


@pytest.fixture(scope="session")
def served() -> Iterator[Served]:
    """One service for all tests; whoever stops it starts it again."""
    served = Served()
    served.start()
    yield served
    served.stop()


@pytest.fixture(scope="session")
def served_both(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A service with the default bundle, and one that is asked with a camera image."""
    camera = write_image_bundle(tmp_path_factory.mktemp("camera"))
    served = Served("--bundle", str(DEFAULT_BUNDLE), "--bundle", str(camera))
    served.start()
    yield served
    served.stop()


@pytest.fixture
def served_copies(tmp_path: Path) -> Iterator[tuple[Served, list[Path]]]:
    """A service with both, in folders that a test may change."""
    camera = tmp_path / "camera"
    camera.mkdir()
    copies = [Path(shutil.copytree(DEFAULT_BUNDLE, tmp_path / "map")), write_image_bundle(camera)]
    served = Served(*(option for copy in copies for option in ("--bundle", str(copy))))
    served.start()
    yield served, copies
    served.stop()


@pytest.fixture(scope="session")
def served_driving(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A service with GoalFlow, and with a planner that asks for something else."""
    camera = write_image_bundle(tmp_path_factory.mktemp("camera"))
    served = Served("--bundle", str(DEFAULT_BUNDLE.parent / "goalflow"), "--bundle", str(camera))
    served.start()
    yield served
    served.stop()


@pytest.fixture(scope="session")
def served_v2x() -> Iterator[Served]:
    """A service with the default bundle, and one that takes two pictures of any size and a text."""
    served = Served("--bundle", str(DEFAULT_BUNDLE), "--bundle", str(DEFAULT_BUNDLE.parent / "v2x"))
    served.start()
    yield served
    served.stop()


@pytest.fixture(scope="session")
def served_student() -> Iterator[Served]:
    """A service with the default bundle, its student, and V2X, which is asked without a map."""
    names = ("default", "student", "v2x")
    folders = (str(DEFAULT_BUNDLE.parent / name) for name in names)
    served = Served(*(option for folder in folders for option in ("--bundle", folder)))
    served.start()
    yield served
    served.stop()


@pytest.fixture(scope="session")
def served_one_robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A service whose card lets a request set no limit, and whose anchors all last 8 s."""
    folder = tmp_path_factory.mktemp("robot") / "bundle"
    shutil.copytree(DEFAULT_BUNDLE, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["conditioning"]["ranges"] = {}
    manifest["conditioning"]["limits"]["horizon_s"] = 8.0
    manifest["time"]["dt"] = 8.0 / (manifest["time"]["steps"] - 1)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    served = Served("--bundle", str(folder))
    served.start()
    yield served
    served.stop()


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Served]:
    """A service that asks for the token "open sesame"."""
    digest = hashlib.sha256(b"open sesame").hexdigest()
    (tmp_path / "tokens").write_text(f"visitor infer sha256:{digest}\n")
    guarded = Served("--tokens", str(tmp_path / "tokens"))
    guarded.start()
    yield guarded
    guarded.stop()


@pytest.fixture(scope="session")
def artefacts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where screenshots are kept: ANCHORFLOW_ARTEFACTS, or a temporary folder."""
    folder = Path(os.environ.get("ANCHORFLOW_ARTEFACTS") or tmp_path_factory.mktemp("page"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


class Visit:
    """A page that is open, with the map in metres and the service's answers."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.errors: list[str] = []
        """What the browser wrote to its console as an error."""
        self.requests: list[Request] = []
        """Those that have been answered."""
        page.on("requestfinished", lambda request: self.requests.append(request))  # noqa: PLW0108
        page.on("console", self._note)
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    def locate(self, selector: str) -> Any:
        return self.page.locator(selector)

    def at(self, point: Point) -> Point:
        """Where a point in m is, in pixels of the window."""
        box = self.locate("#canvas").bounding_box()
        x, y = (value / MAP_M + 0.5 for value in point)
        return box["x"] + x * box["width"], box["y"] + (1 - y) * box["height"]

    def handle(self, name: str) -> Point:
        """The middle of a handle in pixels of the window."""
        box = self.locate(f"[data-handle={name}]").bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag(self, start: Point, end: Point, *, steps: int = 6) -> None:
        """Press, move, let go; in pixels of the window."""
        self.page.mouse.move(*start)
        self.page.mouse.down()
        self.page.mouse.move(*end, steps=steps)
        self.page.mouse.up()

    def drag_end(self, name: str, point: Point) -> None:
        """Bring the start or the goal to a point in m."""
        self.drag(self.handle(name), self.at(point))

    def answer(
        self, act: Callable[[], object], when: Callable[[Any], bool], *, to: str = "/anchors"
    ) -> Exchange:
        """The first exchange after `act` whose request, parsed, is what is waited for."""

        def fits(response: Response) -> bool:
            return response.url.endswith(to) and when(asked_in(response))

        with self.page.expect_response(fits, timeout=1e3 * PATIENCE_S) as caught:
            act()
        return Exchange(caught.value)

    def choose_empty_map(self) -> Exchange:
        """The exchange about a map without obstacles, straight from left to right."""
        self.locate("#sample").select_option("empty")
        self.drag_end("start", (-4.0, 0.0))
        return self.answer(
            lambda: self.drag_end("goal", (4.0, 0.0)),
            lambda asked: asked["x_goal"][:2] == pytest.approx([4.0, 0.0], abs=0.05),
        )

    def wait_for_anchors(self) -> None:
        """Until an answer to the scene is shown: the page can be used from then on."""
        wait_for_text(self, "#summary", "anchors are safe")

    def choose_camera(self) -> None:
        """Ask the camera planner from now on; returns when its first answer is shown."""
        self.wait_for_anchors()
        self.locate("#bundle").select_option("tiny-camera")
        wait_for_text(self, "#summary", "6 anchors")

    @staticmethod
    def occupied(asked: Any) -> np.ndarray:
        """[H,W] whether a cell of a request's map is an obstacle."""
        return np.array(asked["cost_map"]["data"][0]) >= OCCUPIED

    def forget_errors(self, reason: str) -> None:
        """The browser notes every answer that is not 200; here one was provoked."""
        assert any(reason in error for error in self.errors)
        self.errors[:] = [error for error in self.errors if reason not in error]

    def picture(self) -> bytes:
        """The map with what is on it."""
        return self.locate("#board").screenshot()

    def wait_for_another_picture(self, before: bytes) -> None:
        """Until the map looks different."""
        for _ in range(10 * PATIENCE_S):
            if self.picture() != before:
                return
            self.page.wait_for_timeout(100)
        pytest.fail("the picture has not changed")

    def _note(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.errors.append(f"{message.text} ({message.location['url']})")


class Exchange:
    """A request to the service and what came back, both in the contract's JSON."""

    def __init__(self, response: Response) -> None:
        self.status = response.status
        self.asked = asked_in(response)
        self.answered = answered_in(response)


def asked_in(response: Response) -> Any:
    """What the request of a response says, be it right or wrong."""
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
    """What a response says."""
    length = response.headers.get(HEADER_LENGTH)
    if length is None:
        return response.json()
    batch = OipCodec().decode_answer(Payload(response.body(), int(length)))
    return json.loads(JsonCodec().encode_answer(batch).body)


@pytest.fixture
def open_page(browser: Browser, served: Served) -> Iterator[Callable[..., Visit]]:
    """Opens the page in a browser of its own; the options are those of a Playwright context."""
    contexts = []

    def open_with(url: str = served.url, **options: Any) -> Visit:
        desk: dict[str, Any] = {"viewport": {"width": 1440, "height": 900}}
        context = browser.new_context(**desk | options)
        context.set_default_timeout(1e3 * PATIENCE_S)
        contexts.append(context)
        visit = Visit(context.new_page())
        visit.page.goto(url)
        return visit

    yield open_with
    for context in contexts:
        context.close()


@pytest.fixture(scope="module")
def call(browser: Browser, served: Served) -> Iterator[Callable[..., Any]]:
    """Calls a function of JavaScript with `m`, the module of that name, and an argument."""
    context = browser.new_context()
    page = context.new_page()
    page.goto(served.url)

    def run(module: str, function: str, argument: Any = None) -> Any:
        script = f"async (argument) => ({function})(await import('/page/js/{module}.js'), argument)"
        return page.evaluate(script, argument)

    yield run
    context.close()


@pytest.fixture
def camera(open_page: Callable[..., Visit], served_both: Served) -> Iterator[Visit]:
    """The page with the camera planner chosen, its first answer shown."""
    visit = open_page(served_both.url)
    visit.choose_camera()
    yield visit
    assert visit.errors == []


@pytest.fixture
def copied() -> Callable[[Visit, str], str]:
    """Presses a button and gives what it put on the clipboard."""

    def copy(visit: Visit, button: str) -> str:
        visit.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        visit.locate("#scene-note").evaluate("note => { note.textContent = ''; }")
        visit.locate(button).click()
        wait_for_text(visit, "#scene-note", "Copied for")
        return visit.page.evaluate("navigator.clipboard.readText()")

    return copy


@pytest.fixture
def visit(open_page: Callable[..., Visit]) -> Iterator[Visit]:
    """The page on a desk, its first answer shown; the test ends with an empty console."""
    visit = open_page()
    visit.wait_for_anchors()
    yield visit
    assert visit.errors == []


def wait_for_text(visit: Visit, selector: str, text: str) -> None:
    """Until an element shows a text."""
    from playwright.sync_api import expect

    expect(visit.locate(selector)).to_contain_text(text, timeout=1e3 * PATIENCE_S)
