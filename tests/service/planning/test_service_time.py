"""Estimates of waiting time in refusals."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import pytest

from anchorflow_client import Overloaded
from anchorflow_service.planning import Arrival, PlanningQueue, ServiceLimits
from anchorflow_service.planning.job import Job
from anchorflow_service.planning.queue import ServiceTimeEstimate

PATIENCE_S = 20


def test_the_mean_forgets_slowly() -> None:
    estimate = ServiceTimeEstimate(lanes=1)
    assert estimate.mean_s == 0.0
    estimate.observe(1.0)
    assert estimate.mean_s == 1.0
    estimate.observe(2.0)
    assert estimate.mean_s == pytest.approx(1.2)


def test_the_wait_is_the_time_of_those_ahead_over_the_lanes() -> None:
    estimate = ServiceTimeEstimate(lanes=2)
    estimate.observe(3.0)

    assert estimate.wait_s(10) == pytest.approx(15.0)
    assert estimate.retry_after_s(10) == 15
    assert estimate.retry_after_s(0) == 1  # the least that a header can say


class Clock:
    """Stands still until it is set."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def taught(queue: PlanningQueue, clock: Clock, seconds: float) -> None:
    """Run one request of that duration."""

    def work(_: object) -> None:
        clock.now += seconds

    asyncio.run(queue.run(work))


def behind(queue: PlanningQueue, clock: Clock, *, waiting: int, budget_ms: float) -> Any:
    """Return the outcome of a job behind one that runs and `waiting` others."""
    reached, opened = threading.Event(), threading.Event()

    def hold(_: object) -> None:
        reached.set()
        assert opened.wait(PATIENCE_S)

    async def ask() -> Any:
        ahead = [asyncio.ensure_future(queue.run(hold))]
        await asyncio.to_thread(reached.wait, PATIENCE_S)
        ahead += [asyncio.ensure_future(queue.run(lambda _: None)) for _ in range(waiting)]
        await asyncio.sleep(0)
        job: Job[str] = Job(lambda _: "done", Arrival(clock=clock), budget_ms=budget_ms)
        mine = asyncio.ensure_future(queue.submit(job))
        await asyncio.sleep(0)
        opened.set()
        await asyncio.gather(*ahead)
        (outcome,) = await asyncio.gather(mine, return_exceptions=True)
        return outcome

    return asyncio.run(ask())


def test_who_cannot_be_answered_in_time_hears_it_at_once(clock: Clock) -> None:
    with PlanningQueue(ServiceLimits(threads=1), clock=clock) as queue:
        taught(queue, clock, 2.0)
        refused = behind(queue, clock, waiting=3, budget_ms=7_999.0)

    assert isinstance(refused, Overloaded)
    assert refused.retry_after_s == 6  # those three
    assert "3 requests wait already" in refused.message
    assert "about 8000 ms of a budget of 7999 ms" in refused.message


@pytest.mark.parametrize(
    ("seconds", "waiting", "budget_ms"),
    [
        (2.0, 3, 8_001.0),
        (2.0, 0, 500.0),  # none ahead: only a run shows how long it takes
        (0.0, 3, 500.0),  # no service time known yet
    ],
)
def test_who_may_be_answered_in_time_is_let_in(
    clock: Clock, seconds: float, waiting: int, budget_ms: float
) -> None:
    with PlanningQueue(ServiceLimits(threads=1), clock=clock) as queue:
        taught(queue, clock, seconds)
        outcome = behind(queue, clock, waiting=waiting, budget_ms=budget_ms)

    assert outcome == "done"


def test_the_refusal_of_a_full_queue_counts_those_at_work_too(clock: Clock) -> None:
    opened = threading.Event()

    async def fill(queue: PlanningQueue) -> Overloaded:
        wait: Callable[[object], object] = lambda _: opened.wait(PATIENCE_S)  # noqa: E731
        held = [asyncio.ensure_future(queue.run(wait)) for _ in range(5)]
        await asyncio.sleep(0)
        with pytest.raises(
            Overloaded, match="4 requests wait already; try again in 15 s"
        ) as caught:
            await queue.run(wait)
        opened.set()
        await asyncio.gather(*held)
        return caught.value

    with PlanningQueue(ServiceLimits(threads=1, max_waiting=4), clock=clock) as queue:
        taught(queue, clock, 3.0)
        assert asyncio.run(fill(queue)).retry_after_s == 15
