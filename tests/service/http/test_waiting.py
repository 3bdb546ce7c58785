"""Inference stays off the event loop, and only so many requests wait for it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from anchorflow_client import AnchorBatch, AnchorClient, Overloaded
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService, ServiceLimits

PATIENCE_S = 20


class Gate:
    """Holds an engine's answers back until it is opened."""

    def __init__(self) -> None:
        self.reached = threading.Event()
        self.opened = threading.Event()

    def __call__(self, batch: AnchorBatch) -> AnchorBatch:
        self.reached.set()
        assert self.opened.wait(PATIENCE_S)
        return batch


@pytest.fixture
def gate(engine: Any) -> Iterator[Gate]:
    engine.before_answer = Gate()
    yield engine.before_answer
    engine.before_answer.opened.set()


@pytest.fixture
def background() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as executor:
        yield executor


def test_health_answers_while_an_engine_is_busy(
    service: Any, gate: Gate, fields: dict[str, Any], background: ThreadPoolExecutor
) -> None:
    answer = background.submit(service.post, fields)
    assert gate.reached.wait(PATIENCE_S)

    for path in ("/v2/health/live", "/v2/health/ready", "/v2/models"):
        assert service.request("GET", path).status_code == 200
    assert not answer.done()

    gate.opened.set()
    assert answer.result(PATIENCE_S).status_code == 200


def test_one_too_many_is_told_when_to_come_back(
    run: Any, engine: Any, gate: Gate, fields: dict[str, Any], background: ThreadPoolExecutor
) -> None:
    planning = PlanningService(
        {"a": engine}, default="a", limits=ServiceLimits(max_waiting=0, threads=1)
    )
    service = run(create_app(planning))
    answer = background.submit(service.post, fields)
    assert gate.reached.wait(PATIENCE_S)

    with pytest.raises(Overloaded, match="try again in 1 s") as caught:
        AnchorClient("http://test", transport=service).plan(**fields)
    assert (caught.value.http_status, caught.value.retry_after_s) == (429, 1)

    gate.opened.set()
    assert answer.result(PATIENCE_S).status_code == 200
    assert service.post(fields).status_code == 200
