"""Cancelled work is not begun, or ends within a step."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    DeadlineExceeded,
    JsonCodec,
    Overloaded,
    Superseded,
)
from anchorflow_service.planning import Call, PlanningService, ServiceLimits

CODEC = JsonCodec()
PATIENCE_S = 20


class SteppingEngine:
    """Plans in steps, which the test releases; `check` is called after each."""

    def __init__(self, engine: Any) -> None:
        self._engine = engine
        self.card = engine.card
        self.steps = threading.Semaphore(0)
        self.at_work = threading.Semaphore(0)
        self.taken = 0
        self.left = threading.Event()

    def plan(
        self, request: AnchorRequest, /, *, threads: int, check: Callable[[], object]
    ) -> AnchorBatch:
        self.at_work.release()
        try:
            for _ in range(3):
                assert self.steps.acquire(timeout=PATIENCE_S)
                self.taken += 1
                check()
        finally:
            self.left.set()
        return self._engine.plan(request, threads=threads, check=check)


@pytest.fixture
def stepping(engine: Any) -> SteppingEngine:
    return SteppingEngine(engine)


@pytest.fixture
def service(stepping: SteppingEngine) -> PlanningService:
    limits = ServiceLimits(threads=1, max_waiting=2)
    return PlanningService({"lines": stepping}, default="lines", limits=limits)


Ask = Callable[..., "asyncio.Task[Any]"]
UntilWaiting = Callable[[int], Awaitable[None]]


@pytest.fixture
def ask(service: PlanningService, fields: dict[str, Any]) -> Ask:
    def start(**changes: Any) -> asyncio.Task[Any]:
        payload = CODEC.encode_request(AnchorRequest.from_fields(fields | changes))
        return asyncio.ensure_future(service.answer(Call(payload, CODEC, service.arrival(), "r")))

    return start


@pytest.fixture
def until_waiting(service: PlanningService, until: Any) -> UntilWaiting:
    """Waits until that many jobs wait for a lane."""
    return lambda count: asyncio.to_thread(until, lambda: service.queue.num_waiting == count)


async def happened(event: threading.Event) -> None:
    assert await asyncio.to_thread(event.wait, PATIENCE_S)


async def until_at_work(stepping: SteppingEngine) -> None:
    assert await asyncio.to_thread(stepping.at_work.acquire, timeout=PATIENCE_S)


def test_who_hangs_up_frees_the_engine_at_the_next_step(
    service: PlanningService, stepping: SteppingEngine, ask: Ask
) -> None:
    async def hang_up() -> None:
        task = ask()
        await until_at_work(stepping)
        task.cancel()
        await asyncio.wait([task])
        assert service.queue.in_flight == 0
        stepping.steps.release()
        await happened(stepping.left)

    with service:
        asyncio.run(hang_up())
    assert stepping.taken == 1


def test_a_spent_budget_is_told_at_once_and_frees_the_engine_at_the_next_step(
    service: PlanningService, stepping: SteppingEngine, ask: Ask
) -> None:
    """The caller gets the error while the engine is still in the middle of its step."""

    async def expire() -> None:
        with pytest.raises(DeadlineExceeded, match="while planning"):
            await ask(budget_ms=1500)
        assert stepping.taken == 0
        stepping.steps.release()
        await happened(stepping.left)

    with service:
        asyncio.run(expire())
    assert stepping.taken == 1


def test_a_budget_that_is_spent_in_the_queue_is_told_at_once_too(
    service: PlanningService, stepping: SteppingEngine, ask: Ask
) -> None:
    async def expire() -> None:
        first = ask()
        await until_at_work(stepping)
        with pytest.raises(DeadlineExceeded, match="in the queue"):
            await ask(budget_ms=1500)
        assert service.queue.num_waiting == 0
        stepping.steps.release(3)
        await first

    with service:
        asyncio.run(expire())
    assert stepping.taken == 3  # none of them for the second


def test_a_newer_request_of_the_robot_supersedes_one_that_is_planned(
    service: PlanningService, stepping: SteppingEngine, ask: Ask
) -> None:
    async def supersede() -> None:
        older = ask(robot_id="r1")
        await until_at_work(stepping)
        newer = ask(robot_id="r1", seed=2)
        with pytest.raises(Superseded, match="robot_id 'r1'"):
            await older
        stepping.steps.release()  # the older one's next step is its last
        await until_at_work(stepping)
        stepping.steps.release(3)
        assert CODEC.decode_answer(await newer).seed == 2

    with service:
        asyncio.run(supersede())
    assert stepping.taken == 4


def test_a_newer_request_of_the_robot_supersedes_one_that_waits(
    service: PlanningService, stepping: SteppingEngine, ask: Ask, until_waiting: UntilWaiting
) -> None:
    async def supersede() -> None:
        first = ask(robot_id="another")
        await until_at_work(stepping)
        older = ask(robot_id="r1")
        await until_waiting(1)
        newer = ask(robot_id="r1", seed=2)
        with pytest.raises(Superseded):
            await older
        stepping.steps.release(6)
        await asyncio.gather(first, newer)

    with service:
        asyncio.run(supersede())
    assert stepping.taken == 6


def test_who_is_in_a_batch_that_no_lane_has_taken_still_waits(
    service: PlanningService, stepping: SteppingEngine, ask: Ask, until_waiting: UntilWaiting
) -> None:
    async def batch() -> None:
        first = ask()
        await until_at_work(stepping)
        waiting = [ask(), ask()]
        await until_waiting(2)
        stepping.steps.release(3)
        await first
        await until_at_work(stepping)  # one of the two; the other has left the line with it
        assert service.queue.num_waiting == 1
        assert service.queue.oldest_wait_s > 0.0
        for each in waiting:
            each.cancel()
        await asyncio.wait(waiting)
        assert service.queue.num_waiting == 0
        assert service.queue.oldest_wait_s == 0.0
        stepping.steps.release()

    with service:
        asyncio.run(batch())


def test_who_leaves_makes_room(
    service: PlanningService, stepping: SteppingEngine, ask: Ask, until_waiting: UntilWaiting
) -> None:
    async def fill() -> None:
        first = ask()
        await until_at_work(stepping)
        waiting = [ask(), ask()]
        await until_waiting(2)
        with pytest.raises(Overloaded):
            await ask()
        for each in waiting:
            each.cancel()
        await asyncio.wait(waiting)
        assert service.queue.in_flight == 1
        stepping.steps.release(6)
        await asyncio.gather(first, ask())

    with service:
        asyncio.run(fill())


def test_where_no_place_is_left_a_robot_has_that_of_its_older_request(
    service: PlanningService, stepping: SteppingEngine, ask: Ask, until_waiting: UntilWaiting
) -> None:
    async def fill() -> None:
        first = ask()
        await until_at_work(stepping)
        older, other = ask(robot_id="r1"), ask(robot_id="r2")
        await until_waiting(2)
        newer = ask(robot_id="r1", seed=2)
        with pytest.raises(Superseded):
            await older
        for refused in (ask(), ask(robot_id="r3")):
            with pytest.raises(Overloaded, match="2 requests wait already"):
                await refused
        stepping.steps.release(9)
        await asyncio.gather(first, other, newer)
        assert service.queue.in_flight == 0

    with service:
        asyncio.run(fill())


def test_the_place_may_be_on_a_lane(
    service: PlanningService, stepping: SteppingEngine, ask: Ask, until_waiting: UntilWaiting
) -> None:
    async def fill() -> None:
        older = ask(robot_id="r1")
        await until_at_work(stepping)
        others = [ask(), ask()]
        await until_waiting(2)
        newer = ask(robot_id="r1", seed=2)
        with pytest.raises(Superseded):
            await older
        stepping.steps.release(10)
        await asyncio.gather(*others, newer)

    with service:
        asyncio.run(fill())


def test_who_is_refused_supersedes_nobody(
    stepping: SteppingEngine, fields: dict[str, Any], until: Any
) -> None:
    now = 7.0

    def take_50_s(_: object) -> None:
        nonlocal now
        now += 50.0

    service = PlanningService(
        {"lines": stepping},
        default="lines",
        limits=ServiceLimits(threads=1),
        clock=lambda: now,
    )

    def ask(**changes: Any) -> asyncio.Task[Any]:
        payload = CODEC.encode_request(AnchorRequest.from_fields(fields | changes))
        return asyncio.ensure_future(service.answer(Call(payload, CODEC, service.arrival(), "r")))

    async def fill() -> None:
        await service.queue.run(take_50_s)
        first = ask()
        await until_at_work(stepping)
        older, other = ask(robot_id="r1"), ask()
        await asyncio.to_thread(until, lambda: service.queue.num_waiting == 2)
        with pytest.raises(Overloaded, match=r"1 requests wait already.* 100000 ms"):
            await ask(robot_id="r1", seed=2, budget_ms=60_000)
        stepping.steps.release(9)
        await asyncio.gather(first, older, other)

    with service:
        asyncio.run(fill())


def test_who_is_refused_a_place_costs_no_reading(
    service: PlanningService,
    stepping: SteppingEngine,
    ask: Ask,
    until_waiting: UntilWaiting,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def refuse() -> None:
        first = ask()
        await until_at_work(stepping)
        waiting = [ask(), ask()]
        await until_waiting(2)
        monkeypatch.setattr(JsonCodec, "decode_request", None)
        with pytest.raises(Overloaded):
            await ask()
        stepping.steps.release(9)
        await asyncio.gather(first, *waiting)

    with service:
        asyncio.run(refuse())
