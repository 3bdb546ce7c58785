"""Micro-batches: which jobs are in one, with how many threads, in which order."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Hashable

import pytest

from anchorflow_service.planning import Arrival, JobContext, PlanningQueue, ServiceLimits
from anchorflow_service.planning.job import Job

pytestmark = pytest.mark.anyio
PATIENCE_S = 20
TWO_OF_FOUR = ServiceLimits(threads=4, max_batch=2, batch_wait_ms=PATIENCE_S * 1e3)


class Works:
    """Jobs that record their contexts; the first one occupies its lane until `go_on` is set."""

    def __init__(self) -> None:
        self.contexts: dict[str, JobContext] = {}
        """In the order of the work."""
        self.held, self.go_on = threading.Event(), threading.Event()

    async def hold(self, queue: PlanningQueue) -> asyncio.Future[None]:
        """Occupy a lane."""

        def work(_: JobContext) -> None:
            self.held.set()
            assert self.go_on.wait(PATIENCE_S)

        busy = asyncio.ensure_future(queue.run(work))
        await asyncio.to_thread(self.held.wait, PATIENCE_S)
        return busy

    def job(self, name: str, key: Hashable = "a") -> Job[None]:
        def work(context: JobContext) -> None:
            self.contexts[name] = context

        return Job(work, Arrival(), key=key)


@pytest.fixture
def works() -> Works:
    return Works()


@pytest.mark.parametrize(
    ("max_batch", "arrived", "order"),
    [
        (16, "a1 b1 a2 b2 a3", "a1 a2 a3 b1 b2"),
        (2, "a1 b1 a2 a3 a4", "a1 a2 b1 a3 a4"),  # so that nobody is passed by for long
        (1, "a1 b1 a2", "a1 b1 a2"),
    ],
    ids=["all that waits", "up to a bound", "no batches"],
)
async def test_a_batch_is_what_waits_when_a_lane_becomes_free(
    works: Works, max_batch: int, arrived: str, order: str
) -> None:
    """A name's letter is its key."""
    with PlanningQueue(ServiceLimits(threads=1, max_batch=max_batch)) as queue:
        busy = await works.hold(queue)
        jobs = [works.job(name, name[0]) for name in arrived.split()]
        waiting = [asyncio.ensure_future(queue.submit(job)) for job in jobs]
        await asyncio.sleep(0)
        works.go_on.set()
        await asyncio.gather(busy, *waiting)

    assert list(works.contexts) == order.split()


async def test_a_batch_that_is_full_waits_no_longer_and_shares_the_threads(works: Works) -> None:
    """Both lanes are idle when the batch of two is made, so each request has half of them."""
    with PlanningQueue(TWO_OF_FOUR) as queue:
        first = asyncio.ensure_future(queue.submit(works.job("a1")))
        await asyncio.sleep(0)
        both = asyncio.gather(first, queue.submit(works.job("a2")))
        await asyncio.wait_for(both, PATIENCE_S / 2)

    assert {name: context.threads for name, context in works.contexts.items()} == {"a1": 2, "a2": 2}


async def test_who_finds_another_at_work_has_only_the_idle_lanes(works: Works) -> None:
    with PlanningQueue(ServiceLimits(threads=2)) as queue:
        busy = await works.hold(queue)
        await queue.submit(works.job("a1"))
        works.go_on.set()
        await busy

    assert works.contexts["a1"].threads == 1


async def test_who_waits_for_others_in_vain_is_planned_alone(works: Works) -> None:
    with PlanningQueue(ServiceLimits(threads=1, batch_wait_ms=30.0)) as queue:
        await queue.submit(works.job("a1"))

    assert works.contexts["a1"].queue_ms >= 30.0


async def test_a_batch_does_not_wait_for_who_was_called_off(works: Works) -> None:
    """The one that is waited with leaves: the next one waits its own time, and is not lost."""
    with PlanningQueue(ServiceLimits(threads=1, batch_wait_ms=30.0)) as queue:
        first = asyncio.ensure_future(queue.submit(works.job("a1")))
        await asyncio.sleep(0)
        first.cancel()
        await asyncio.wait([first])
        await queue.submit(works.job("b1", "b"))

    assert list(works.contexts) == ["b1"]
