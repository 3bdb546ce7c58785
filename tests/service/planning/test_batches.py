"""Micro-batches: which jobs are in one, with how many threads, in which order."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Hashable
from typing import Any

import pytest

from anchorflow_service.planning import Arrival, JobContext, PlanningQueue, ServiceLimits
from anchorflow_service.planning.job import Job

PATIENCE_S = 20
AGES_MS = PATIENCE_S * 1e3


class Works:
    """Jobs that record their contexts; the first one occupies its lane until `go_on` is set."""

    def __init__(self) -> None:
        self.order: list[str] = []
        self.contexts: dict[str, JobContext] = {}
        self.held = threading.Event()
        self.go_on = threading.Event()

    def hold(self, _: JobContext) -> None:
        self.held.set()
        assert self.go_on.wait(PATIENCE_S)

    def job(self, name: str, key: Hashable) -> Job[None]:
        def work(context: JobContext) -> None:
            self.order.append(name)
            self.contexts[name] = context

        return Job(work, Arrival(), key=key)


@pytest.fixture
def works() -> Works:
    return Works()


async def behind_a_busy_lane(queue: PlanningQueue, works: Works, *names: str) -> None:
    """Jobs that all wait by the time that the only lane is free; a name's letter is its key."""
    busy = asyncio.ensure_future(queue.run(works.hold))
    await asyncio.to_thread(works.held.wait, PATIENCE_S)
    waiting = [asyncio.ensure_future(queue.submit(works.job(name, name[0]))) for name in names]
    await asyncio.sleep(0)
    works.go_on.set()
    await asyncio.gather(busy, *waiting)


def test_a_batch_is_what_waits_when_a_lane_becomes_free(works: Works) -> None:
    with PlanningQueue(ServiceLimits(threads=1)) as queue:
        asyncio.run(behind_a_busy_lane(queue, works, "a1", "b1", "a2", "b2", "a3"))

    assert works.order == ["a1", "a2", "a3", "b1", "b2"]


def test_a_batch_has_its_bound_so_that_nobody_is_passed_by_for_long(works: Works) -> None:
    with PlanningQueue(ServiceLimits(threads=1, max_batch=2)) as queue:
        asyncio.run(behind_a_busy_lane(queue, works, "a1", "b1", "a2", "a3", "a4"))

    assert works.order == ["a1", "a2", "b1", "a3", "a4"]


def test_without_batches_it_is_first_come_first_served(works: Works) -> None:
    with PlanningQueue(ServiceLimits(threads=1, max_batch=1)) as queue:
        asyncio.run(behind_a_busy_lane(queue, works, "a1", "b1", "a2"))

    assert works.order == ["a1", "b1", "a2"]


async def two_in_turn(queue: PlanningQueue, works: Works) -> None:
    first = asyncio.ensure_future(queue.submit(works.job("a1", "a")))
    await asyncio.sleep(0)
    second = asyncio.ensure_future(queue.submit(works.job("a2", "a")))
    await asyncio.gather(first, second)


def test_a_batch_may_wait_for_others_and_goes_once_it_is_full(works: Works) -> None:
    limits = ServiceLimits(threads=4, max_batch=2, batch_wait_ms=AGES_MS)
    with PlanningQueue(limits) as queue:
        asyncio.run(asyncio.wait_for(two_in_turn(queue, works), PATIENCE_S / 2))

    assert works.order in (["a1", "a2"], ["a2", "a1"])


def test_a_batch_shares_the_threads(works: Works) -> None:
    """Both lanes are idle when the batch of two is made, so each request has half of them."""
    limits = ServiceLimits(threads=4, max_batch=2, batch_wait_ms=AGES_MS)
    with PlanningQueue(limits) as queue:
        asyncio.run(two_in_turn(queue, works))

    assert {name: context.threads for name, context in works.contexts.items()} == {"a1": 2, "a2": 2}


def test_who_finds_another_at_work_has_only_the_idle_lanes(works: Works) -> None:
    async def ask(queue: PlanningQueue) -> None:
        busy = asyncio.ensure_future(queue.run(works.hold))
        await asyncio.to_thread(works.held.wait, PATIENCE_S)
        await queue.submit(works.job("a1", "a"))
        works.go_on.set()
        await busy

    with PlanningQueue(ServiceLimits(threads=2)) as queue:
        asyncio.run(ask(queue))

    assert works.contexts["a1"].threads == 1


def test_who_waits_for_others_in_vain_is_planned_alone(works: Works) -> None:
    with PlanningQueue(ServiceLimits(threads=1, batch_wait_ms=30.0)) as queue:
        asyncio.run(queue.submit(works.job("a1", "a")))

    assert works.contexts["a1"].queue_ms >= 30.0


def test_a_batch_does_not_wait_for_who_was_called_off(works: Works) -> None:
    """The one that is waited with leaves: the next one waits its own time, and is not lost."""

    async def ask(queue: PlanningQueue) -> Any:
        first = asyncio.ensure_future(queue.submit(works.job("a1", "a")))
        await asyncio.sleep(0)
        first.cancel()
        await asyncio.wait([first])
        return await queue.submit(works.job("b1", "b"))

    with PlanningQueue(ServiceLimits(threads=1, batch_wait_ms=30.0)) as queue:
        asyncio.run(ask(queue))

    assert works.order == ["b1"]
