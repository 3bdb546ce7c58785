"""Inference stays off the event loop, and only so many requests wait for it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from anchorflow_client import AnchorBatch, AnchorClient, NotReady, Overloaded
from anchorflow_service.http import Limits, create_app
from anchorflow_service.http.budget import Arrival
from anchorflow_service.http.planning import PlanningQueue

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
    service = run(create_app({"a": engine}, default="a", limits=Limits(max_waiting=0)))
    answer = background.submit(service.post, fields)
    assert gate.reached.wait(PATIENCE_S)

    with pytest.raises(Overloaded, match="try again in 1 s") as caught:
        AnchorClient("http://test", transport=service).plan(**fields)
    assert (caught.value.http_status, caught.value.retry_after_s) == (429, 1)

    gate.opened.set()
    assert answer.result(PATIENCE_S).status_code == 200
    assert service.post(fields).status_code == 200


def test_the_queue_lets_so_many_wait() -> None:
    opened = threading.Event()

    async def fill(queue: PlanningQueue) -> list[Any]:
        jobs = [
            asyncio.ensure_future(queue.run(lambda _: opened.wait(PATIENCE_S))) for _ in range(4)
        ]
        done, _ = await asyncio.wait(jobs, return_when=asyncio.FIRST_COMPLETED)
        assert len(done) == 1
        opened.set()
        return await asyncio.gather(*jobs, return_exceptions=True)

    with PlanningQueue(workers=1, max_waiting=2) as queue:
        *answered, refused = asyncio.run(fill(queue))
        assert answered == [True, True, True]
        assert isinstance(refused, Overloaded)
        assert asyncio.run(queue.run(lambda queue_ms: queue_ms)) >= 0


def test_a_job_that_fails_gives_its_place_back() -> None:
    def fail(_: float) -> None:
        raise ZeroDivisionError

    with PlanningQueue(workers=1, max_waiting=0) as queue:
        for _ in range(3):
            with pytest.raises(ZeroDivisionError):
                asyncio.run(queue.run(fail))


def test_a_caller_who_leaves_gives_his_place_back() -> None:
    opened = threading.Event()

    async def leave(queue: PlanningQueue) -> None:
        running = asyncio.ensure_future(queue.run(lambda _: opened.wait(PATIENCE_S)))
        waiting = asyncio.ensure_future(queue.run(lambda _: None))
        await asyncio.sleep(0)
        waiting.cancel()
        await asyncio.wait([waiting])
        another = asyncio.ensure_future(queue.run(lambda _: "another"))
        await asyncio.sleep(0)
        opened.set()
        assert await running
        assert await another == "another"

    with PlanningQueue(workers=1, max_waiting=1) as queue:
        asyncio.run(leave(queue))


def test_a_closed_queue_is_not_ready() -> None:
    with pytest.raises(NotReady):
        asyncio.run(PlanningQueue(workers=1, max_waiting=0).run(lambda _: None))


def test_the_wait_grows_with_the_observed_service_time() -> None:
    queue = PlanningQueue(workers=2, max_waiting=8)
    for _ in range(50):
        queue._observe(3.0)
    queue._in_flight = 10

    with pytest.raises(Overloaded) as caught:
        queue._admit()
    assert caught.value.retry_after_s == 15


def test_a_budget_counts_from_arrival() -> None:
    now = [100.0]
    arrival = Arrival(clock=lambda: now[0])
    now[0] = 100.05

    assert arrival.elapsed_ms == pytest.approx(50)
    arrival.check(60, "in the queue")
    arrival.check(None, "in the queue")
    with pytest.raises(Exception, match=r"within 40 ms, 50\.0 ms had passed in the queue"):
        arrival.check(40, "in the queue")
