"""Client disconnects over a real socket: the work ends with the current step."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import pytest
from fastapi import FastAPI

from anchorflow_client import AnchorBatch, AnchorRequest
from anchorflow_client.contract import ResolvedRequest
from anchorflow_service.engine.samplers.ode import FlowStates
from anchorflow_service.http import create_app
from anchorflow_service.planning import (
    ANSWERED,
    CANCELLED,
    Call,
    Observer,
    PlanningService,
    ServiceLimits,
)

PATIENCE_S = 20


class StepByStep:
    """An engine that takes a step when the test releases one, and calls `check` after each."""

    def __init__(self, engine: Any) -> None:
        self._engine = engine
        self.card = engine.card
        self.at_work = threading.Event()
        self.step = threading.Semaphore(0)
        self.steps_taken = 0
        self.left = threading.Event()

    def plan(
        self, request: AnchorRequest, /, *, threads: int, check: Callable[[], object]
    ) -> AnchorBatch:
        self.at_work.set()
        try:
            for _ in range(4):
                assert self.step.acquire(timeout=PATIENCE_S)
                self.steps_taken += 1
                check()
        finally:
            self.left.set()
        return self._engine.plan(request, threads=threads, check=check)

    def flow_states(self, request: ResolvedRequest, /) -> FlowStates:
        raise AssertionError(request)


class Outcomes(Observer):
    """What became of every call."""

    def __init__(self) -> None:
        self.seen: list[str] = []
        self.heard = threading.Event()

    def ended(self, call: Call, outcome: str) -> None:  # noqa: ARG002
        self.seen.append(outcome)
        self.heard.set()


@pytest.fixture
def stepping(engine: Any) -> StepByStep:
    return StepByStep(engine)


@pytest.fixture
def planning(stepping: StepByStep) -> PlanningService:
    return PlanningService({"lines": stepping}, default="lines", limits=ServiceLimits(threads=1))


@pytest.fixture
def outcomes(planning: PlanningService) -> Outcomes:
    outcomes = Outcomes()
    planning.watch(outcomes)
    return outcomes


def post(url: str, path: str, body: bytes, behind: bytes = b"") -> socket.socket:
    """A request on its way, and what is sent behind it, and the connection of both."""
    address = urlsplit(url)
    place = (address.hostname, address.port or 80)
    connection = socket.create_connection(place, timeout=PATIENCE_S)
    head = f"POST {path} HTTP/1.1\r\nHost: test\r\nContent-Length: {len(body)}\r\n\r\n"
    connection.sendall(head.encode() + body + behind)
    return connection


def oip(fields: dict[str, Any]) -> dict[str, Any]:
    """The same request for any client of the protocol."""
    cost_map = fields["cost_map"]
    shapes = {"x_curr": [6], "x_goal": [4], "map_geometry": [3], "cost_map": [1, 16, 20]}
    data = {
        "x_curr": fields["x_curr"],
        "x_goal": fields["x_goal"],
        "map_geometry": [-5.0, -4.0, cost_map["resolution"]],
        "cost_map": cost_map["data"],
    }
    return {
        "inputs": [
            {"name": name, "datatype": "FP64", "shape": shapes[name], "data": data[name]}
            for name in shapes
        ]
    }


@pytest.mark.parametrize("path", ["/anchors", "/v2/models/lines/infer"])
def test_who_hangs_up_frees_the_engine_at_its_next_step(
    planning: PlanningService,
    stepping: StepByStep,
    outcomes: Outcomes,
    fields: dict[str, Any],
    listen: Callable[[FastAPI], str],
    path: str,
) -> None:
    url = listen(create_app(planning))
    body = fields if path == "/anchors" else oip(fields)
    with post(url, path, json.dumps(body).encode()):
        assert stepping.at_work.wait(PATIENCE_S)
    assert outcomes.heard.wait(PATIENCE_S)  # the service has seen the client leave
    stepping.step.release(4)
    assert stepping.left.wait(PATIENCE_S)

    assert stepping.steps_taken == 1
    assert outcomes.seen == [CANCELLED]
    assert planning.queue.in_flight == 0


def test_who_hangs_up_in_the_queue_is_not_planned(
    planning: PlanningService,
    stepping: StepByStep,
    outcomes: Outcomes,
    fields: dict[str, Any],
    listen: Callable[[FastAPI], str],
    until: Any,
) -> None:
    url, body = listen(create_app(planning)), json.dumps(fields).encode()
    with post(url, "/anchors", body) as first:
        assert stepping.at_work.wait(PATIENCE_S)
        with post(url, "/anchors", body):
            until(lambda: planning.queue.in_flight == 2)
        assert outcomes.heard.wait(PATIENCE_S)
        stepping.step.release(8)
        assert b"200 OK" in first.recv(4096)

    assert stepping.steps_taken == 4
    assert outcomes.seen == [CANCELLED, ANSWERED]


def test_who_hangs_up_gives_the_place_of_a_replay_back(
    planning: PlanningService,
    stepping: StepByStep,
    fields: dict[str, Any],
    listen: Callable[[FastAPI], str],
    until: Any,
) -> None:
    url, body = listen(create_app(planning)), json.dumps(fields).encode()
    with post(url, "/anchors", body) as first:
        assert stepping.at_work.wait(PATIENCE_S)
        with post(url, "/page/flow", body):
            until(lambda: planning.queue.in_flight == 2)
        until(lambda: planning.queue.in_flight == 1)
        stepping.step.release(4)
        assert b"200 OK" in first.recv(4096)
