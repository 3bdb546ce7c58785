"""Cancelled work is not begun, or ends within a step."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from straight_lines import SteppingEngine

from anchorflow_client import AnchorRequest, DeadlineExceeded, JsonCodec, Overloaded, Superseded
from anchorflow_service.planning import Call, PlanningService, ServiceLimits

pytestmark = pytest.mark.anyio
CODEC = JsonCodec()
PATIENCE_S = 20

Ask = Callable[..., "asyncio.Task[Any]"]
Until = Callable[[int], Awaitable[None]]


@pytest.fixture
def service(stepping: SteppingEngine) -> Iterator[PlanningService]:
    limits = ServiceLimits(threads=1, max_waiting=2)
    with PlanningService({"lines": stepping}, default="lines", limits=limits) as service:
        yield service


@pytest.fixture
def ask(service: PlanningService, fields: dict[str, Any]) -> Ask:
    def start(**changes: Any) -> asyncio.Task[Any]:
        payload = CODEC.encode_request(AnchorRequest.from_fields(fields | changes))
        return asyncio.ensure_future(service.answer(Call(payload, CODEC, service.arrival(), "r")))

    return start


@pytest.fixture
def until_waiting(service: PlanningService, until: Any) -> Until:
    """Waits until that many jobs wait for a lane."""
    return lambda count: asyncio.to_thread(until, lambda: service.queue.num_waiting == count)


async def until_at_work(stepping: SteppingEngine) -> None:
    assert await asyncio.to_thread(stepping.at_work.acquire, timeout=PATIENCE_S)


async def until_left(stepping: SteppingEngine) -> None:
    assert await asyncio.to_thread(stepping.left.wait, PATIENCE_S)


async def test_who_hangs_up_frees_the_engine_at_the_next_step(
    service: PlanningService, stepping: SteppingEngine, ask: Ask
) -> None:
    task = ask()
    await until_at_work(stepping)
    task.cancel()
    await asyncio.wait([task])
    assert service.queue.in_flight == 0
    stepping.steps.release()
    await until_left(stepping)
    assert stepping.taken == 1


async def test_a_spent_budget_is_told_at_once_and_frees_the_engine_at_the_next_step(
    stepping: SteppingEngine, ask: Ask
) -> None:
    """The caller gets the error while the engine is still in the middle of its step."""
    with pytest.raises(DeadlineExceeded, match="while planning"):
        await ask(budget_ms=1500)
    assert stepping.taken == 0
    stepping.steps.release()
    await until_left(stepping)
    assert stepping.taken == 1


async def test_a_budget_that_is_spent_in_the_queue_is_told_at_once_too(
    service: PlanningService, stepping: SteppingEngine, ask: Ask
) -> None:
    first = ask()
    await until_at_work(stepping)
    with pytest.raises(DeadlineExceeded, match="in the queue"):
        await ask(budget_ms=1500)
    assert service.queue.num_waiting == 0
    stepping.steps.release(3)
    await first
    assert stepping.taken == 3  # none of them for the second


async def test_a_newer_request_of_the_robot_supersedes_one_that_is_planned(
    stepping: SteppingEngine, ask: Ask
) -> None:
    older = ask(robot_id="r1")
    await until_at_work(stepping)
    newer = ask(robot_id="r1", seed=2)
    with pytest.raises(Superseded, match="robot_id 'r1'"):
        await older
    stepping.steps.release()  # the older one's next step is its last
    await until_at_work(stepping)
    stepping.steps.release(3)
    assert CODEC.decode_answer(await newer).seed == 2
    assert stepping.taken == 4


async def test_a_newer_request_of_the_robot_supersedes_one_that_waits(
    stepping: SteppingEngine, ask: Ask, until_waiting: Until
) -> None:
    first = ask(robot_id="another")
    await until_at_work(stepping)
    older = ask(robot_id="r1")
    await until_waiting(1)
    newer = ask(robot_id="r1", seed=2)
    with pytest.raises(Superseded):
        await older
    stepping.steps.release(6)
    await asyncio.gather(first, newer)
    assert stepping.taken == 6


@pytest.fixture
def fill(stepping: SteppingEngine, ask: Ask, until_waiting: Until) -> Callable[..., Any]:
    """Occupies the only lane and both places in the line, each by a robot or by nobody."""

    async def fill(*robots: str | None) -> list[asyncio.Task[Any]]:
        first = ask(robot_id=robots[0])
        await until_at_work(stepping)
        waiting = [ask(robot_id=robot) for robot in robots[1:]]
        await until_waiting(2)
        return [first, *waiting]

    return fill


async def test_who_is_in_a_batch_that_no_lane_has_taken_still_waits(
    service: PlanningService, stepping: SteppingEngine, fill: Callable[..., Any]
) -> None:
    first, *waiting = await fill(None, None, None)
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


async def test_who_leaves_makes_room(
    service: PlanningService, stepping: SteppingEngine, ask: Ask, fill: Callable[..., Any]
) -> None:
    first, *waiting = await fill(None, None, None)
    with pytest.raises(Overloaded):
        await ask()
    for each in waiting:
        each.cancel()
    await asyncio.wait(waiting)
    assert service.queue.in_flight == 1
    stepping.steps.release(6)
    await asyncio.gather(first, ask())


async def test_where_no_place_is_left_a_robot_has_that_of_its_older_request(
    service: PlanningService, stepping: SteppingEngine, ask: Ask, fill: Callable[..., Any]
) -> None:
    first, older, other = await fill(None, "r1", "r2")
    newer = ask(robot_id="r1", seed=2)
    with pytest.raises(Superseded):
        await older
    for refused in (ask(), ask(robot_id="r3")):
        with pytest.raises(Overloaded, match="2 requests wait already"):
            await refused
    stepping.steps.release(9)
    await asyncio.gather(first, other, newer)
    assert service.queue.in_flight == 0


async def test_the_place_may_be_on_a_lane(
    stepping: SteppingEngine, ask: Ask, fill: Callable[..., Any]
) -> None:
    older, *others = await fill("r1", None, None)
    newer = ask(robot_id="r1", seed=2)
    with pytest.raises(Superseded):
        await older
    stepping.steps.release(10)
    await asyncio.gather(*others, newer)


async def test_who_is_refused_supersedes_nobody(
    service: PlanningService, stepping: SteppingEngine, ask: Ask, fill: Callable[..., Any]
) -> None:
    service.queue.mean_service_s = 50.0
    first, older, other = await fill(None, "r1", None)
    with pytest.raises(Overloaded, match=r"1 requests wait already.* 100000 ms"):
        await ask(robot_id="r1", seed=2, budget_ms=60_000)
    stepping.steps.release(9)
    await asyncio.gather(first, older, other)


async def test_who_is_refused_a_place_costs_no_reading(
    stepping: SteppingEngine,
    ask: Ask,
    fill: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = await fill(None, None, None)
    monkeypatch.setattr(JsonCodec, "decode_request", None)
    with pytest.raises(Overloaded):
        await ask()
    stepping.steps.release(9)
    await asyncio.gather(*asked)
