"""The async client with concurrent requests, against the real endpoint."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from anchorflow_client import AnchorBatch, AnchorRequest, Cancelled
from anchorflow_client.zenoh_client import AsyncZenohAnchorClient
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

PATIENCE_S = 20


async def reach(gate: Any) -> None:
    assert await asyncio.to_thread(gate.reached.wait, PATIENCE_S)


def test_concurrent_requests_are_all_sent(
    replica: ZenohEndpoint,
    endpoint: str,
    planning: PlanningService,
    gate: Any,
    fields: dict[str, Any],
) -> None:
    assert replica

    async def ask() -> list[AnchorBatch]:
        async with AsyncZenohAnchorClient(endpoint) as client:
            asked = asyncio.gather(*(client.plan(**fields, request_id=f"r{n}") for n in range(4)))
            while planning.queue.in_flight < 4:
                await asyncio.sleep(0.001)
            gate.opened.set()
            return await asked

    assert [anchors.request_id for anchors in asyncio.run(ask())] == [f"r{n}" for n in range(4)]


def test_a_cancelled_task_frees_its_thread(
    replica: ZenohEndpoint, endpoint: str, gate: Any, fields: dict[str, Any]
) -> None:
    assert replica

    async def ask() -> bool:
        async with AsyncZenohAnchorClient(endpoint, max_threads=1) as client:
            asked = asyncio.ensure_future(client.plan(**fields))
            await reach(gate)
            asked.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asked
            return await client.live()  # there is one thread, and the engine is still at work

    assert asyncio.run(ask())


def test_leaving_the_block_cancels_pending_requests(
    replica: ZenohEndpoint, endpoint: str, gate: Any, fields: dict[str, Any]
) -> None:
    assert replica
    request = AnchorRequest.from_fields(fields)

    async def ask() -> AnchorBatch:
        async with AsyncZenohAnchorClient(endpoint) as client:
            asked = asyncio.ensure_future(client.plan_request(request))
            await reach(gate)
        return await asked

    with pytest.raises(Cancelled):
        asyncio.run(ask())
