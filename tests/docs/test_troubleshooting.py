"""The code gives every message of the page, word for word."""

from __future__ import annotations

import asyncio
import json
import shutil
import socket
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from image_planner import write_image_bundle

from anchorflow_benchmarks.programs import free_port
from anchorflow_cli.extras import needs_extra
from anchorflow_cli.main import main
from anchorflow_client import (
    AnchorClient,
    AnchorFlowError,
    AnchorRequest,
    RequestError,
    TooLarge,
)
from anchorflow_client.contract import resolve_for_card
from anchorflow_client.http.transport import HttpAnswer, SocketTransport
from anchorflow_docs.page_blocks import messages_of, wording
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http.tokens import TokenFile, TokenGuard, token_line
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import Arrival, PlanningQueue, ServiceLimits
from anchorflow_service.planning.job import Job
from anchorflow_service.planning.service import LatestPerRobot

PAGE = Path(__file__).parents[2] / "docs" / "troubleshooting.md"
MESSAGES = messages_of(PAGE)
RESOLUTION = 0.16


def occupancy() -> np.ndarray:
    grid = np.zeros((1, 64, 64))
    grid[0, 20:44, 30:34] = 1.0
    return grid


def cost_map(data: np.ndarray) -> dict[str, Any]:
    return {"data": data.tolist(), "resolution": RESOLUTION}


GOOD: dict[str, Any] = {
    "cost_map": cost_map(occupancy()),
    "x_curr": [-3, 0, 0, 0, 0, 0],
    "x_goal": [3, 0, 0, 0],
}
REFUSED: dict[str, dict[str, Any]] = {
    "goal-in-obstacle": {"x_goal": [0, 0, 0, 0]},
    "start-off-the-map": {"x_curr": [-6, 0, 0, 0, 0, 0]},
    "states-of-another-length": {"x_curr": [-3, 0]},
    "state-too-fast": {"x_curr": [-3, 0, 500, 0, 0, 0]},
    "map-without-channels": {"cost_map": cost_map(occupancy()[0])},
    "map-of-percent": {"cost_map": cost_map(100 * occupancy())},
    "map-with-nan": {"cost_map": cost_map(np.nan * occupancy())},
    "map-too-small": {"cost_map": cost_map(np.zeros((1, 8, 8)))},
    "style-unknown": {"w_style": "fast"},
    "misspelt-field": {"num_sample": 16},
    "schedule-without-noise": {"sampler": {"schedule": [0.5, 1.0]}},
    "batches-that-differ": {"x_curr": [GOOD["x_curr"]] * 2, "x_goal": [GOOD["x_goal"]] * 3},
}
"""Changes to a good request, by message."""


@dataclass(frozen=True)
class Around:
    """The default bundle's engine, the URL of a service of it, and an empty folder."""

    engine: Engine
    url: str
    folder: Path


def refused(name: str, around: Around) -> None:
    LocalClient(around.engine).plan_request(AnchorRequest.from_fields(GOOD | REFUSED[name]))


RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "limit-of-another-model": {},
    "limit-beyond-training": {"v_max": (0.1, 6.0)},
}
"""Ranges of a card that refuses 9 m/s, by message."""


def out_of_range(name: str, around: Around) -> None:
    card = around.engine.card
    card = replace(card, conditioning=replace(card.cost_map, ranges=RANGES[name]))
    resolve_for_card(AnchorRequest.from_fields(GOOD | {"v_max": 9.0}), card)


def map_for_another_planner(around: Around) -> None:
    with LocalClient.of(write_image_bundle(around.folder), threads=1) as client:
        client.plan(**GOOD)


def unknown_model(around: Around) -> None:
    with AnchorClient(around.url) as client:
        client.plan(**GOOD, model="mine")


def budget_spent(around: Around) -> None:
    with AnchorClient(around.url) as client:
        client.plan(**GOOD, budget_ms=0.01)


def body_too_large(around: Around) -> None:
    transport = SocketTransport(around.url, connect_timeout_s=5.0)
    status, _, answer = transport.send("POST", "/anchors", {}, b" " * 17 * 2**20, 30.0)
    transport.close()
    assert status == TooLarge.http_status
    raise RequestError.from_dict(json.loads(answer))


def queue() -> PlanningQueue:
    """Return a queue with room for one waiting job."""
    return PlanningQueue(ServiceLimits(threads=1, max_waiting=1))


def too_many_wait(_: Around) -> None:
    with queue() as full, ExitStack() as places:
        while True:
            places.enter_context(full.place())


def not_ready(_: Around) -> None:
    with queue().place():
        raise AssertionError("a closed queue has no place")


def superseded(_: Around) -> None:
    older, newer = (Job(lambda _: None, Arrival()) for _ in range(2))
    latest = LatestPerRobot()
    with latest.registered("rover-7", newer), latest.registered("rover-7", older):
        raise AssertionError("the older one is refused")


def nobody_listens(_: Around) -> None:
    AnchorClient(f"http://127.0.0.1:{free_port()}").plan(**GOOD)


def no_word(_: Around) -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        AnchorClient(f"http://127.0.0.1:{listener.getsockname()[1]}", timeout_s=0.05) as client,
    ):
        client.plan(**GOOD)


def another_program(_: Around) -> None:
    with HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as other:
        threading.Thread(target=other.handle_request).start()
        with AnchorClient(f"http://127.0.0.1:{other.server_port}") as client:
            client.plan(**GOOD)


class BadGateway:
    """A proxy that does not reach the service."""

    def send(self, *_: object, **__: object) -> HttpAnswer:
        return 502, {}, b"<html>Bad gateway</html>"

    def close(self) -> None:
        pass


def proxy(_: Around) -> None:
    AnchorClient("http://127.0.0.1:8000", transport=BadGateway()).plan(**GOOD)


def no_token(around: Around) -> None:
    file = around.folder / "tokens"
    file.write_text(token_line("robot", ("infer",), "secret"))
    guard = TokenGuard(lambda *_: pytest.fail("it was let through"), tokens=TokenFile(file))

    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app=guard)
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return await client.post("/anchors")

    raise RequestError.from_dict(asyncio.run(ask()).json())


def bundle_missing(around: Around) -> None:
    load_bundle(around.folder / "bundles" / "mine")


def bundle_changed(around: Around) -> None:
    mine = shutil.copytree(DEFAULT_BUNDLE, around.folder / "bundles" / "mine")
    with (mine / "field.onnx").open("ab") as graph:
        graph.write(b"?")
    load_bundle(mine)


def bundle_of_another_format(around: Around) -> None:
    mine = shutil.copytree(DEFAULT_BUNDLE, around.folder / "bundles" / "mine")
    manifest = json.loads((mine / "manifest.json").read_text())
    (mine / "manifest.json").write_text(json.dumps(manifest | {"format": 1}))
    load_bundle(mine)


def port_taken(_: Around) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        main(["serve", "--port", str(listener.getsockname()[1])])


def extra_missing(_: Around) -> None:
    with needs_extra("service", who="anchorflow serve"):
        raise ModuleNotFoundError(name="onnxruntime")


CASES: dict[str, Callable[[Around], None]] = {
    **{name: partial(refused, name) for name in REFUSED},
    **{name: partial(out_of_range, name) for name in RANGES},
    "map-for-another-planner": map_for_another_planner,
    "unknown-model": unknown_model,
    "budget-spent": budget_spent,
    "body-too-large": body_too_large,
    "too-many-wait": too_many_wait,
    "not-ready": not_ready,
    "superseded": superseded,
    "nobody-listens": nobody_listens,
    "no-word": no_word,
    "another-program": another_program,
    "proxy": proxy,
    "no-token": no_token,
    "bundle-missing": bundle_missing,
    "bundle-changed": bundle_changed,
    "bundle-of-another-format": bundle_of_another_format,
    "port-taken": port_taken,
    "extra-missing": extra_missing,
}
"""Programs that end with a message of the page."""


@pytest.mark.usefixtures("capfd")  # another program's log
@pytest.mark.parametrize("name", CASES)
def test_the_code_says_what_the_page_says(
    name: str, default_engine: Engine, service_url: str, tmp_path: Path
) -> None:
    with pytest.raises((AnchorFlowError, SystemExit)) as caught:
        CASES[name](Around(default_engine, service_url, tmp_path))

    said = str(caught.value).replace(f"{tmp_path}/", "")
    assert wording(said) == wording(MESSAGES[name])


def test_every_message_of_the_page_is_checked() -> None:
    assert sorted(CASES) == sorted(MESSAGES)


def test_the_wording_is_what_is_compared() -> None:
    assert wording("expected 2.5 m, got 3 m") == wording("expected 10 m, got 0.25 m")
    assert wording("expected 2 m, got 3 m") != wording("expected 2 s, got 3 m")
