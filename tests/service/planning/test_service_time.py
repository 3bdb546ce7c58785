"""Estimates of waiting time in refusals."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

from anchorflow_client import Overloaded
from anchorflow_service.planning import Arrival, PlanningQueue, ServiceLimits
from anchorflow_service.planning.job import Job

pytestmark = pytest.mark.anyio
PATIENCE_S = 20


class Clock:
    """Stands still until it is set."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


async def teach(queue: PlanningQueue, clock: Clock, seconds: float) -> None:
    """Run one request of that duration."""

    def work(_: object) -> None:
        clock.now += seconds

    await queue.run(work)


async def test_the_mean_forgets_slowly(clock: Clock) -> None:
    with PlanningQueue(ServiceLimits(threads=1), clock=clock) as queue:
        assert queue.mean_service_s == 0.0
        await teach(queue, clock, 1.0)
        assert queue.mean_service_s == 1.0
        await teach(queue, clock, 2.0)
        assert queue.mean_service_s == pytest.approx(1.2)


async def behind(queue: PlanningQueue, clock: Clock, *, waiting: int, budget_ms: float) -> Any:
    """Return the outcome of a job behind one that runs and `waiting` others."""
    reached, opened = threading.Event(), threading.Event()

    def hold(_: object) -> None:
        reached.set()
        assert opened.wait(PATIENCE_S)

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


async def test_who_cannot_be_answered_in_time_hears_it_at_once(clock: Clock) -> None:
    with PlanningQueue(ServiceLimits(threads=1), clock=clock) as queue:
        await teach(queue, clock, 2.0)
        refused = await behind(queue, clock, waiting=3, budget_ms=7_999.0)

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
async def test_who_may_be_answered_in_time_is_let_in(
    clock: Clock, seconds: float, waiting: int, budget_ms: float
) -> None:
    with PlanningQueue(ServiceLimits(threads=1), clock=clock) as queue:
        await teach(queue, clock, seconds)
        assert await behind(queue, clock, waiting=waiting, budget_ms=budget_ms) == "done"


@pytest.mark.parametrize(("lanes", "service_s", "retry_after_s"), [(1, 3.0, 15), (2, 3.0, 9)])
async def test_the_refusal_of_a_full_queue_counts_those_at_work_too(
    clock: Clock, lanes: int, service_s: float, retry_after_s: int
) -> None:
    opened = threading.Event()
    message = f"4 requests wait already; try again in {retry_after_s} s"
    with PlanningQueue(ServiceLimits(threads=lanes, max_waiting=4), clock=clock) as queue:
        await teach(queue, clock, service_s)
        jobs = [queue.run(lambda _: opened.wait(PATIENCE_S)) for _ in range(4 + lanes)]
        held = [asyncio.ensure_future(job) for job in jobs]
        await asyncio.sleep(0)
        with pytest.raises(Overloaded, match=message) as caught:
            await queue.run(lambda _: None)
        opened.set()
        await asyncio.gather(*held)
    assert caught.value.retry_after_s == retry_after_s
