"""The page's files as the service sends them, and the flow of its replay."""

from __future__ import annotations

import gzip
import json
import re
import threading
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_client.contract import AnchorRequest, resolve_for_card
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.http.page import (
    FOLDER,
    MAX_REPLAYED_ANCHORS,
    MAX_REPLAYED_STEPS,
    page_files,
)
from anchorflow_service.planning import PlanningService

FILES = dict(page_files())
FIRST_LOAD_BYTES = 320 * 1000
TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".json": "application/json",
    ".svg": "image/svg",
}


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_every_file_is_sent_as_it_lies(service: Any) -> None:
    for url, path in FILES.items():
        answer = service.request("GET", url)
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith(TYPES[path.suffix])
        assert answer.content == path.read_bytes(), url


def test_nothing_of_the_folder_is_left_out() -> None:
    assert set(FILES.values()) == {path for path in FOLDER.rglob("*") if path.is_file()}


def test_a_small_page() -> None:
    # The samples are loaded with the planners that they are for.
    raw = [path.read_bytes() for path in FILES.values() if path.suffix != ".json"]

    assert sum(map(len, raw)) < FIRST_LOAD_BYTES
    assert sum(len(gzip.compress(body)) for body in raw) < FIRST_LOAD_BYTES / 3


def test_it_travels_zipped_where_the_browser_can_unzip(service: Any) -> None:
    plain = service.request("GET", "/", headers={"Accept-Encoding": "identity"})
    zipped = service.request("GET", "/", headers={"Accept-Encoding": "gzip, br"})

    assert "content-encoding" not in plain.headers
    assert zipped.headers["content-encoding"] == "gzip"
    assert int(zipped.headers["content-length"]) < int(plain.headers["content-length"]) / 2
    assert zipped.content == plain.content
    assert zipped.headers["vary"] == "Accept-Encoding"


def test_what_the_browser_has_is_not_sent_again(service: Any) -> None:
    first = service.request("GET", "/page/js/app.js")
    again = service.request(
        "GET", "/page/js/app.js", headers={"If-None-Match": first.headers["etag"]}
    )
    older = service.request("GET", "/page/js/app.js", headers={"If-None-Match": 'W/"old"'})

    assert first.headers["cache-control"] == "no-cache"
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["etag"] == first.headers["etag"]
    assert older.status_code == 200


def test_head_tells_what_get_would(service: Any) -> None:
    head, get = service.request("HEAD", "/"), service.request("GET", "/")

    assert head.status_code == 200
    assert head.headers["etag"] == get.headers["etag"]


@pytest.mark.parametrize(
    "url", ["/page", "/page/", "/page/nothing.js", "/page/../app.py", "/page/%2e%2e/app.py"]
)
def test_what_is_not_there_is_refused_in_the_contracts_words(service: Any, url: str) -> None:
    answer = service.request("GET", url)

    assert answer.status_code == 404
    assert answer.json()["error"]["code"] == "invalid_request"


def test_nothing_runs_that_does_not_come_from_the_service(service: Any) -> None:
    policy = service.request("GET", "/").headers["content-security-policy"]
    sources = dict(part.split(" ", 1) for part in policy.split("; "))

    assert sources["default-src"] == "'none'"
    for kind in ("script-src", "style-src", "connect-src", "img-src"):
        assert sources[kind] == "'self'"
    assert sources["frame-ancestors"] == "'none'"


def test_the_text_keeps_the_policy() -> None:
    for path in FILES.values():
        text = text_of(path)
        hosts = set(re.findall(r"https?://([^/\s\"'`]+)", text))
        assert hosts <= {"www.w3.org"}, path  # the name of SVG, not an address
        if path.suffix == ".html":
            assert not re.search(r"<script(?![^>]*\bsrc=)", text)
            assert not re.search(r"<style|\sstyle=|\son\w+=", text)


def test_what_planners_share_knows_nothing_of_their_kinds() -> None:
    script = FOLDER / "js"
    for path in FILES.values():
        imported = set(re.findall(r'from "\.{1,2}/(map|tensors)/', text_of(path)))
        if path != script / "app.js":
            assert not imported, path


def test_the_page_is_no_part_of_the_contract(service: Any) -> None:
    paths = service.request("GET", "/openapi.json").json()["paths"]

    assert not {path for path in paths if path == "/" or path.startswith("/page")}


def themes() -> tuple[dict[str, str], dict[str, str]]:
    """Return the colours of the light and of the dark theme."""
    light, dark = re.findall(r":root \{(.*?)\}", text_of(FOLDER / "layout.css"), re.DOTALL)
    read = [dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", part)) for part in (light, dark)]
    return read[0], read[0] | read[1]


def luminance(colour: str) -> float:
    """Return the relative luminance of #rrggbb by WCAG."""
    parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", themes(), ids=["light", "dark"])
def test_text_can_be_read(theme: dict[str, str]) -> None:
    pairs = [
        *product(("ink", "soft", "accent", "bad"), ("paper", "card")),
        ("soft", "sunk"),
        ("accent-ink", "accent"),
        ("accent", "accent-wash"),
        ("ink", "accent-wash"),
        ("bad", "bad-wash"),
        ("soft", "map"),
    ]
    too_faint = {
        pair: round(contrast(theme[pair[0]], theme[pair[1]]), 2)
        for pair in pairs
        if contrast(theme[pair[0]], theme[pair[1]]) < 4.5
    }

    assert not too_faint


@pytest.mark.parametrize("theme", themes(), ids=["light", "dark"])
def test_what_is_drawn_can_be_told_apart(theme: dict[str, str]) -> None:
    for name in ("wall", "start", "goal"):
        assert contrast(theme[name], theme["map"]) >= 3, name


# The flow


def post_flow(service: Any, fields: dict[str, Any]) -> Any:
    return service.request("POST", "/page/flow", content=json.dumps(fields).encode())


@pytest.fixture
def flowing(tiny_bundle: Path, run: Callable[..., Any]) -> Any:
    """The application over a bundle whose flow moves by the mean of each map channel."""
    engine = Engine(load_bundle(tiny_bundle), threads=1)
    return run(create_app(PlanningService({"tiny": engine}, default="tiny")))


@pytest.fixture
def flow_fields(fields: dict[str, Any]) -> dict[str, Any]:
    """A request whose flow moves x by half a metre, as half of its map is occupied."""
    occupancy = np.zeros((1, 16, 16))
    occupancy[0, :8] = 1.0
    return fields | {
        "cost_map": {"data": occupancy.tolist(), "resolution": 0.5},
        "x_curr": [-3.0, 2.0, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [3.0, 2.0, 0.0, 0.0],
        "sampler": {"method": "rk4", "schedule": [0.0, 0.25, 0.5, 1.0]},
    }


def test_the_states_of_a_flow(flowing: Any, flow_fields: dict[str, Any]) -> None:
    answer = post_flow(flowing, flow_fields)
    assert answer.status_code == 200
    times = np.array(answer.json()["times"])
    positions = np.array(answer.json()["positions"])

    assert times.tolist() == [0.0, 0.25, 0.5, 1.0]
    assert positions.shape == (4, 4, 8, 2)
    # dx/dt = 4 t³ times the channel means 0.5 (occupied), 1 (traversable): exact for rk4.
    moved = (positions - positions[0]).transpose(0, 3, 1, 2).reshape(4, 2, -1)
    np.testing.assert_allclose(moved[:, 0].T, np.tile(0.5 * times**4, (4 * 8, 1)), atol=2e-3)
    np.testing.assert_allclose(moved[:, 1].T, np.tile(1.0 * times**4, (4 * 8, 1)), atol=2e-3)


def test_the_last_state_is_what_the_answer_is_made_of(
    tiny_bundle: Path, flow_fields: dict[str, Any]
) -> None:
    engine = Engine(load_bundle(tiny_bundle), threads=1)
    untouched = {"refine": {"smooth": False, "project": False}}
    asked = AnchorRequest.from_fields(flow_fields | untouched)
    request = resolve_for_card(asked, engine.card)

    states = engine.flow_states(request)

    np.testing.assert_array_equal(states.positions[-1], engine.plan(request).trajectories)


@pytest.mark.parametrize(
    ("change", "field", "expected"),
    [
        (
            {"num_samples": MAX_REPLAYED_ANCHORS + 1},
            "num_samples",
            f"at most {MAX_REPLAYED_ANCHORS}",
        ),
        (
            {"sampler": {"schedule": {"uniform": MAX_REPLAYED_STEPS + 1}}},
            "sampler.schedule",
            f"at most {MAX_REPLAYED_STEPS} steps",
        ),
        ({"x_goal": [[3.0, 2.0, 0.0, 0.0]] * 2}, "x_curr", "one scene"),
        ({"x_goal": [3.0, -2.0, 0.0, 0.0]}, "x_goal", "occupancy below 0.5"),
        ({"seed": "one"}, "seed", "expected"),
    ],
)
def test_a_flow_that_is_refused(
    flowing: Any,
    flow_fields: dict[str, Any],
    change: dict[str, Any],
    field: str,
    expected: str,
) -> None:
    answer = post_flow(flowing, flow_fields | change)

    assert answer.status_code == 422
    assert answer.json()["error"]["field"] == field
    assert expected in answer.json()["error"]["message"]


def test_what_a_flow_is_asked_for_is_read_by_the_services_reader(
    flowing: Any, flow_fields: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader is shared, so that replays do not delay other requests."""
    threads: list[str] = []

    def resolve(*given: Any) -> Any:
        threads.append(threading.current_thread().name.partition("_")[0])
        return resolve_for_card(*given)

    monkeypatch.setattr("anchorflow_service.http.page.resolve_for_card", resolve)

    assert post_flow(flowing, flow_fields).status_code == 200
    assert threads == ["reading"]


def test_a_flow_has_the_budget_of_its_request(flowing: Any, flow_fields: dict[str, Any]) -> None:
    answer = post_flow(flowing, flow_fields | {"budget_ms": 1e-6})

    assert answer.status_code == 504
    assert answer.json()["error"]["code"] == "deadline_exceeded"


def test_an_engine_without_a_flow_says_so(service: Any, fields: dict[str, Any]) -> None:
    answer = post_flow(service, fields)

    assert answer.status_code == 422
    assert answer.json()["error"]["field"] == "model"
    assert "lines" in answer.json()["error"]["message"]


def test_a_planner_that_chooses_from_a_vocabulary_has_no_flow(
    image_bundle: Path, run: Callable[..., Any]
) -> None:
    engine = Engine(load_bundle(image_bundle), threads=1)
    service = run(create_app(PlanningService({"camera": engine}, default="camera")))
    camera = np.zeros((3, 16, 24), int).tolist()

    answer = post_flow(service, {"inputs": {"camera": camera, "ego_status": [1, 0, 0, 0]}})

    assert answer.status_code == 422
    assert answer.json()["error"]["field"] == "model"
    assert "a model with a flow, got tiny-camera" in answer.json()["error"]["message"]
