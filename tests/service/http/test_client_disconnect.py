"""Client disconnects over a real socket: the work ends with the current step."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import pytest
from fastapi import FastAPI
from straight_lines import SteppingEngine

from anchorflow_service.http import create_app
from anchorflow_service.planning import CANCELLED, PlanningService, ServiceLimits

PATIENCE_S = 20


@pytest.fixture
def planning(stepping: SteppingEngine) -> PlanningService:
    return PlanningService({"lines": stepping}, default="lines", limits=ServiceLimits(threads=1))


def post(url: str, path: str, body: bytes) -> socket.socket:
    """The connection of a request on its way."""
    address = urlsplit(url)
    place = (address.hostname, address.port or 80)
    connection = socket.create_connection(place, timeout=PATIENCE_S)
    head = f"POST {path} HTTP/1.1\r\nHost: test\r\nContent-Length: {len(body)}\r\n\r\n"
    connection.sendall(head.encode() + body)
    return connection


@pytest.mark.parametrize("path", ["/anchors", "/v2/models/lines/infer"])
def test_who_hangs_up_frees_the_engine_at_its_next_step(
    planning: PlanningService,
    stepping: SteppingEngine,
    outcomes: Any,
    fields: dict[str, Any],
    body: dict[str, Any],
    listen: Callable[[FastAPI], str],
    path: str,
) -> None:
    url = listen(create_app(planning))
    asked = fields if path == "/anchors" else body
    with post(url, path, json.dumps(asked).encode()):
        assert stepping.at_work.acquire(timeout=PATIENCE_S)
    assert outcomes.heard.wait(PATIENCE_S)  # the service has seen the client leave
    stepping.steps.release(4)
    assert stepping.left.wait(PATIENCE_S)

    assert stepping.taken == 1
    assert outcomes.seen == [CANCELLED]
    assert planning.queue.in_flight == 0


def test_who_hangs_up_gives_the_place_of_a_replay_back(
    planning: PlanningService,
    stepping: SteppingEngine,
    fields: dict[str, Any],
    listen: Callable[[FastAPI], str],
    until: Any,
) -> None:
    url, body = listen(create_app(planning)), json.dumps(fields).encode()
    with post(url, "/anchors", body) as first:
        assert stepping.at_work.acquire(timeout=PATIENCE_S)
        with post(url, "/page/flow", body):
            until(lambda: planning.queue.in_flight == 2)
        until(lambda: planning.queue.in_flight == 1)
        stepping.steps.release(4)
        assert b"200 OK" in first.recv(4096)
