"""Bounds on jobs that run and that wait, and their places when they end."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

from anchorflow_client import NotReady, Overloaded
from anchorflow_service.planning import Arrival, PlanningQueue, ServiceLimits
from anchorflow_service.planning.job import Job

PATIENCE_S = 20


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

    with PlanningQueue(ServiceLimits(threads=1, max_waiting=2)) as queue:
        *answered, refused = asyncio.run(fill(queue))
        assert answered == [True, True, True]
        assert isinstance(refused, Overloaded)
        assert asyncio.run(queue.run(lambda context: context.queue_ms)) >= 0
        assert queue.in_flight == 0


def test_a_job_that_fails_gives_its_place_back() -> None:
    def fail(_: object) -> None:
        raise ZeroDivisionError

    with PlanningQueue(ServiceLimits(threads=1, max_waiting=0)) as queue:
        for _ in range(3):
            with pytest.raises(ZeroDivisionError):
                asyncio.run(queue.run(fail))


def test_whoever_hears_of_a_result_finds_the_lane_free() -> None:
    job: Job[str] = Job(lambda _: "done", Arrival())
    taken: list[str] = []

    def ask_again(_: object) -> None:
        with queue.admitted(Job(lambda _: None, Arrival())):
            taken.append("another")

    with PlanningQueue(ServiceLimits(threads=1, max_waiting=0)) as queue:
        job.result.add_done_callback(ask_again)
        assert asyncio.run(queue.submit(job)) == "done"

    assert taken == ["another"]


def test_a_caller_who_leaves_gives_his_place_back() -> None:
    opened = threading.Event()
    done: list[str] = []

    async def leave(queue: PlanningQueue) -> None:
        running = asyncio.ensure_future(queue.run(lambda _: opened.wait(PATIENCE_S)))
        waiting = asyncio.ensure_future(queue.run(lambda _: done.append("waiting")))
        await asyncio.sleep(0)
        waiting.cancel()
        await asyncio.wait([waiting])
        another = asyncio.ensure_future(queue.run(lambda _: "another"))
        await asyncio.sleep(0)
        opened.set()
        assert await running
        assert await another == "another"

    with PlanningQueue(ServiceLimits(threads=1, max_waiting=1)) as queue:
        asyncio.run(leave(queue))
    assert done == []


def test_a_closed_queue_is_not_ready() -> None:
    with pytest.raises(NotReady):
        asyncio.run(PlanningQueue(ServiceLimits(threads=1)).run(lambda _: None))


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


def test_closing_waits_for_what_runs_and_refuses_what_waits() -> None:
    reached, opened = threading.Event(), threading.Event()

    def work(_: object) -> str:
        reached.set()
        assert opened.wait(PATIENCE_S)
        return "done"

    async def close() -> list[Any]:
        queue = PlanningQueue(ServiceLimits(threads=1)).__enter__()
        jobs = [asyncio.ensure_future(queue.run(work)) for _ in range(2)]
        await asyncio.to_thread(reached.wait, PATIENCE_S)
        closing = asyncio.ensure_future(asyncio.to_thread(queue.__exit__, None, None, None))
        with pytest.raises(NotReady, match="stopping"):
            await jobs[1]
        assert not closing.done()
        opened.set()
        await closing
        return await asyncio.gather(*jobs, return_exceptions=True)

    first, second = asyncio.run(close())
    assert first == "done"
    assert isinstance(second, NotReady)


def test_two_lanes_work_at_the_same_time() -> None:
    both = threading.Barrier(2)

    async def ask(queue: PlanningQueue) -> list[int]:
        jobs = (queue.run(lambda _: both.wait(PATIENCE_S)) for _ in range(2))
        return await asyncio.gather(*jobs)

    with PlanningQueue(ServiceLimits(threads=2, max_batch=2)) as queue:
        assert sorted(asyncio.run(ask(queue))) == [0, 1]


@pytest.mark.parametrize(
    ("limits", "lanes"),
    [
        (ServiceLimits(threads=4), 4),
        (ServiceLimits(threads=4, max_batch=3), 3),
        (ServiceLimits(threads=4, max_batch=1), 1),
    ],
)
def test_there_is_a_lane_for_each_request_that_may_be_planned_at_a_time(
    limits: ServiceLimits, lanes: int
) -> None:
    assert PlanningQueue(limits).num_lanes == lanes


def test_who_is_alone_has_all_threads() -> None:
    for limits in (
        ServiceLimits(threads=6),
        ServiceLimits(threads=6, max_batch=1),
        ServiceLimits(threads=6, max_batch=4),
    ):
        with PlanningQueue(limits) as queue:
            assert asyncio.run(queue.run(lambda context: context.threads)) == 6


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
