"""Inference stays off the event loop, and a bounded number of requests waits for it."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from anchorflow_client import AnchorClient, Overloaded
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService, ServiceLimits

PATIENCE_S = 20


def test_health_answers_while_an_engine_is_busy(
    service: Any, gate: Any, fields: dict[str, Any], background: ThreadPoolExecutor
) -> None:
    answer = background.submit(service.post, fields)
    assert gate.reached.wait(PATIENCE_S)

    for path in ("/v2/health/live", "/v2/health/ready", "/v2/models"):
        assert service.request("GET", path).status_code == 200
    assert not answer.done()

    gate.opened.set()
    assert answer.result(PATIENCE_S).status_code == 200


@pytest.fixture
def full(
    run: Any, engine: Any, gate: Any, fields: dict[str, Any], background: ThreadPoolExecutor
) -> Iterator[Any]:
    """A service whose only place is taken until the gate opens; then it answers again."""
    limits = ServiceLimits(max_waiting=0, threads=1)
    service = run(create_app(PlanningService({"a": engine}, default="a", limits=limits)))
    answer = background.submit(service.post, fields)
    assert gate.reached.wait(PATIENCE_S)
    yield service
    gate.opened.set()
    assert answer.result(PATIENCE_S).status_code == 200
    assert service.post(fields).status_code == 200
    assert service.post(b"nonsense").status_code == 422


def test_one_too_many_is_told_when_to_come_back(full: Any, fields: dict[str, Any]) -> None:
    with pytest.raises(Overloaded, match="try again in 1 s") as caught:
        AnchorClient("http://test", transport=full).plan(**fields)
    assert (caught.value.http_status, caught.value.retry_after_s) == (429, 1)


@pytest.mark.parametrize("path", ["/anchors", "/page/flow"])
def test_for_whom_there_is_no_place_nothing_is_read(full: Any, path: str) -> None:
    assert full.post(b"nonsense", path).status_code == 429
