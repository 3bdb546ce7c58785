"""The real clients, blocking and async, against the real endpoint over loopback."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from anchorflow_client import (
    AnchorRequest,
    Cancellation,
    Cancelled,
    ConnectionFailed,
    Overloaded,
    TimedOut,
)
from anchorflow_client.zenoh_client import AsyncZenohAnchorClient, ZenohAnchorClient, ZenohSettings
from anchorflow_service.planning import PlanningService, ServiceLimits

PATIENCE_S = 20


def test_the_request_carries_the_time_left(
    client: ZenohAnchorClient, endpoint: str, engine: Any, fields: dict[str, Any]
) -> None:
    client.plan(**fields, budget_ms=60_000)
    assert 50_000 < engine.seen[-1].budget_ms < 60_000

    client.plan(**fields)  # no budget: this client's timeout
    assert 10_000 < engine.seen[-1].budget_ms < 20_000

    with ZenohAnchorClient(endpoint, timeout_s=1e6) as endless:
        endless.plan(**fields)
    assert engine.seen[-1].budget_ms == 1e7  # the largest budget


def test_a_budget_bounds_the_wait(
    client: ZenohAnchorClient, gate: Any, fields: dict[str, Any]
) -> None:
    assert client.live()

    # The gate stays closed: a call without this bound would fail 20 s later, with another error.
    with pytest.raises(TimedOut, match="no answer within 1000 ms; asked a"):
        client.plan(**fields, budget_ms=1000)
    gate.opened.set()


def test_a_request_can_be_cancelled(
    client: ZenohAnchorClient, engine: Any, gate: Any, fields: dict[str, Any]
) -> None:
    cancellation = Cancellation()
    request = AnchorRequest.from_fields(fields)
    with ThreadPoolExecutor(1) as executor:
        asked = executor.submit(client.plan_request, request, cancellation=cancellation)
        assert gate.reached.wait(PATIENCE_S)
        cancellation.cancel()
        with pytest.raises(Cancelled):
            asked.result(PATIENCE_S)
    gate.opened.set()

    with pytest.raises(Cancelled):
        client.plan_request(request, cancellation=cancellation)
    assert client.plan(**fields).seed == 1
    assert len(engine.seen) == 2  # the one that was cancelled before was never sent


def test_closing_cancels_pending_requests(
    client: ZenohAnchorClient, gate: Any, fields: dict[str, Any]
) -> None:
    with ThreadPoolExecutor(1) as executor:
        asked = executor.submit(lambda: client.plan(**fields))
        assert gate.reached.wait(PATIENCE_S)
        client.close()
        with pytest.raises(Cancelled):
            asked.result(PATIENCE_S)
    with pytest.raises(ConnectionFailed, match="closed"):
        client.plan(**fields)


def test_threads_may_share_a_client(client: ZenohAnchorClient, fields: dict[str, Any]) -> None:
    with ThreadPoolExecutor(8) as executor:
        answers = list(
            executor.map(lambda seed: client.plan(**fields | {"seed": seed}).seed, range(40))
        )

    assert answers == list(range(40))


def test_no_listener(endpoint: str, fields: dict[str, Any]) -> None:
    peer = ZenohSettings(mode="peer", connect=(endpoint,))
    for where, words in ((endpoint, f"nobody listens at {endpoint}"), (peer, "nobody")):
        with ZenohAnchorClient(where) as client:
            assert not client.live()
            assert not client.ready()
            with pytest.raises(ConnectionFailed, match=words):
                client.plan(**fields)


def test_a_router_without_a_service(
    start_router: Any, endpoint: str, fields: dict[str, Any]
) -> None:
    start_router()
    with ZenohAnchorClient(endpoint) as client:
        assert not client.live()
        with pytest.raises(ConnectionFailed, match="no service is alive there"):
            client.plan(**fields)


def test_the_queue_is_the_services(
    serve: Any, endpoint: str, engine: Any, gate: Any, fields: Any
) -> None:
    """A request beyond the limit is refused, over whatever transport the others arrived."""
    service = PlanningService(
        {"lines": engine}, default="lines", limits=ServiceLimits(max_waiting=0, threads=1)
    )
    serve(ZenohSettings(listen=(endpoint,)), service)
    with ThreadPoolExecutor(1) as executor, ZenohAnchorClient(endpoint) as client:
        occupied = executor.submit(lambda: client.plan(**fields))
        assert gate.reached.wait(PATIENCE_S)
        with pytest.raises(Overloaded, match="try again in 1 s") as caught:
            client.plan(**fields)
        assert caught.value.retry_after_s == 1
        gate.opened.set()
        assert occupied.result(PATIENCE_S).seed == 1


@pytest.mark.anyio
@pytest.mark.usefixtures("replica")
async def test_a_cancelled_task_frees_its_thread(
    endpoint: str, gate: Any, fields: dict[str, Any]
) -> None:
    async with AsyncZenohAnchorClient(endpoint, max_threads=1) as client:
        asked = asyncio.ensure_future(client.plan(**fields))
        assert await asyncio.to_thread(gate.reached.wait, PATIENCE_S)
        asked.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asked
        assert await client.live()  # there is one thread, and the engine is still at work
