"""Bounds on jobs that run and that wait, their places when they end, and how long others wait."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

from anchorflow_client import NotReady, Overloaded
from anchorflow_service.planning import Arrival, PlanningQueue, ServiceLimits
from anchorflow_service.planning.job import Job

pytestmark = pytest.mark.anyio
PATIENCE_S = 20


async def test_a_job_that_fails_gives_its_place_back() -> None:
    with PlanningQueue(ServiceLimits(threads=1, max_waiting=0)) as queue:
        for _ in range(3):
            with pytest.raises(ZeroDivisionError):
                await queue.run(lambda _: 1 / 0)


async def test_whoever_hears_of_a_result_finds_the_lane_free() -> None:
    job: Job[str] = Job(lambda _: "done", Arrival())
    taken: list[str] = []

    def ask_again(_: object) -> None:
        with queue.admitted(Job(lambda _: None, Arrival())):
            taken.append("another")

    with PlanningQueue(ServiceLimits(threads=1, max_waiting=0)) as queue:
        job.result.add_done_callback(ask_again)
        assert await queue.submit(job) == "done"
    assert taken == ["another"]


async def test_a_closed_queue_is_not_ready() -> None:
    with pytest.raises(NotReady):
        await PlanningQueue(ServiceLimits(threads=1)).run(lambda _: None)


def test_what_comes_after_all_was_cancelled_is_not_ready() -> None:
    """A transport that goes last may still bring requests when the time to drain is over."""
    with PlanningQueue(ServiceLimits(threads=1)) as queue:
        with queue.place():
            queue.cancel_all()
            with pytest.raises(NotReady), queue.admitted(Job(lambda _: None, Arrival())):
                pass
        with pytest.raises(NotReady), queue.place():
            pass
        assert not queue.is_open


async def test_closing_waits_for_what_runs_and_refuses_what_waits() -> None:
    reached, opened = threading.Event(), threading.Event()

    def work(_: object) -> str:
        reached.set()
        assert opened.wait(PATIENCE_S)
        return "done"

    queue = PlanningQueue(ServiceLimits(threads=1)).__enter__()
    jobs = [asyncio.ensure_future(queue.run(work)) for _ in range(2)]
    await asyncio.to_thread(reached.wait, PATIENCE_S)
    closing = asyncio.ensure_future(asyncio.to_thread(queue.__exit__, None, None, None))
    with pytest.raises(NotReady, match="stopping"):
        await jobs[1]
    assert not closing.done()
    opened.set()
    await closing
    assert await jobs[0] == "done"


async def test_two_lanes_work_at_the_same_time() -> None:
    both = threading.Barrier(2)
    with PlanningQueue(ServiceLimits(threads=2, max_batch=2)) as queue:
        jobs = (queue.run(lambda _: both.wait(PATIENCE_S)) for _ in range(2))
        assert sorted(await asyncio.gather(*jobs)) == [0, 1]


@pytest.mark.parametrize(("max_batch", "lanes"), [(16, 6), (3, 3), (4, 4), (1, 1)])
async def test_there_is_a_lane_for_each_request_of_a_batch_and_who_is_alone_has_all_threads(
    max_batch: int, lanes: int
) -> None:
    with PlanningQueue(ServiceLimits(threads=6, max_batch=max_batch)) as queue:
        assert queue.num_lanes == lanes
        assert await queue.run(lambda context: context.threads) == 6


async def teach(queue: PlanningQueue, clock: Any, seconds: float) -> None:
    """Run one request of that duration."""

    def work(_: object) -> None:
        clock.now += seconds

    await queue.run(work)


async def test_the_mean_forgets_slowly(clock: Any) -> None:
    with PlanningQueue(ServiceLimits(threads=1), clock=clock) as queue:
        assert queue.mean_service_s == 0.0
        await teach(queue, clock, 1.0)
        assert queue.mean_service_s == 1.0
        await teach(queue, clock, 2.0)
        assert queue.mean_service_s == pytest.approx(1.2)


async def behind(queue: PlanningQueue, clock: Any, *, waiting: int, budget_ms: float) -> Any:
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


async def test_who_cannot_be_answered_in_time_hears_it_at_once(clock: Any) -> None:
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
    clock: Any, seconds: float, waiting: int, budget_ms: float
) -> None:
    with PlanningQueue(ServiceLimits(threads=1), clock=clock) as queue:
        await teach(queue, clock, seconds)
        assert await behind(queue, clock, waiting=waiting, budget_ms=budget_ms) == "done"


@pytest.mark.parametrize(("lanes", "service_s", "retry_after_s"), [(1, 3.0, 15), (2, 3.0, 9)])
async def test_the_refusal_of_a_full_queue_counts_those_at_work_too(
    clock: Any, lanes: int, service_s: float, retry_after_s: int
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


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"max_waiting": -1}, "max_waiting"),
        ({"max_batch": 0}, "max_batch"),
        ({"batch_wait_ms": -1.0}, "batch_wait_ms"),
        ({"batch_wait_ms": float("nan")}, "batch_wait_ms"),
        ({"threads": 0}, "threads"),
        ({"max_body_bytes": 0}, "max_body_bytes"),
    ],
)
def test_bounds_that_leave_nothing_are_refused(changes: dict[str, Any], name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        ServiceLimits(**changes)
