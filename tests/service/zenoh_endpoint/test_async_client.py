"""The async client against the real endpoint over loopback."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorBatch, AnchorRequest, Cancelled, InvalidRequest, UnknownModel
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.zenoh_client import AsyncZenohAnchorClient
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

PATIENCE_S = 20


class Gate:
    """Holds an engine's answers back until it is opened."""

    def __init__(self) -> None:
        self.reached = threading.Event()
        self.opened = threading.Event()

    def __call__(self, batch: AnchorBatch) -> AnchorBatch:
        self.reached.set()
        assert self.opened.wait(PATIENCE_S)
        return batch

    async def reach(self) -> None:
        assert await asyncio.to_thread(self.reached.wait, PATIENCE_S)


@pytest.fixture
def gate(engine: Any) -> Iterator[Gate]:
    engine.before_answer = gate = Gate()
    yield gate
    gate.opened.set()


def test_a_robots_day(
    replica: ZenohEndpoint, endpoint: str, engine: Any, fields: dict[str, Any]
) -> None:
    assert replica

    async def day() -> AnchorBatch:
        async with AsyncZenohAnchorClient(endpoint) as client:
            assert await client.live()
            assert await client.ready()
            assert [card.name for card in await client.models()] == ["lines", "bows"]
            with pytest.raises(UnknownModel, match="'nobody'"):
                await client.plan(**fields, model="nobody")
            with pytest.raises(InvalidRequest, match="expected 2 m/s, which lines") as caught:
                await client.plan(**fields, v_max=9.0)
            assert (caught.value.field, caught.value.http_status) == ("v_max", 422)
            return await client.plan(**fields, request_id="r1")

    anchors = asyncio.run(day())

    planned = engine.plan(engine.seen[-1])
    for name in ARRAY_DTYPES:
        np.testing.assert_array_equal(getattr(anchors, name), getattr(planned, name))
    assert anchors.request_id == "r1"


def test_requests_at_the_same_time_are_all_on_their_way(
    replica: ZenohEndpoint,
    endpoint: str,
    planning: PlanningService,
    gate: Gate,
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


def test_who_is_cancelled_has_a_free_place_again(
    replica: ZenohEndpoint, endpoint: str, gate: Gate, fields: dict[str, Any]
) -> None:
    assert replica

    async def ask() -> bool:
        async with AsyncZenohAnchorClient(endpoint, max_threads=1) as client:
            asked = asyncio.ensure_future(client.plan(**fields))
            await gate.reach()
            asked.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asked
            return await client.live()  # there is one thread, and the engine is still at work

    assert asyncio.run(ask())


def test_leaving_the_block_takes_back_what_is_on_its_way(
    replica: ZenohEndpoint, endpoint: str, gate: Gate, fields: dict[str, Any]
) -> None:
    assert replica
    request = AnchorRequest.from_fields(fields)

    async def ask() -> AnchorBatch:
        async with AsyncZenohAnchorClient(endpoint) as client:
            asked = asyncio.ensure_future(client.plan_request(request))
            await gate.reach()
        return await asked

    with pytest.raises(Cancelled):
        asyncio.run(ask())
