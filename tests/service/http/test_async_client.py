"""The async client against the real application, in this process and over a real socket."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from served import free_endpoint

from anchorflow_client import (
    AnchorClient,
    AsyncAnchorClient,
    ConnectionFailed,
    InvalidRequest,
    JsonCodec,
    TimedOut,
    UnknownModel,
)
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.http.transport import HttpAnswer
from anchorflow_service.planning import CANCELLED, PlanningService

pytestmark = pytest.mark.anyio
PATIENCE_S = 20


class InProcess:
    """The application as a transport, on the client's event loop."""

    def __init__(self, app: FastAPI) -> None:
        transport = httpx.ASGITransport(app=app)
        self._http = httpx.AsyncClient(transport=transport, base_url="http://test")

    async def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,  # noqa: ARG002 - nothing here can hang but the test itself
    ) -> HttpAnswer:
        answer = await self._http.request(method, path, headers=dict(headers), content=body)
        return answer.status_code, answer.headers, answer.content

    async def aclose(self) -> None:
        await self._http.aclose()


@pytest.fixture
def url(app: FastAPI, listen: Callable[[FastAPI], str]) -> str:
    return listen(app)


async def reach(gate: Any) -> None:
    assert await asyncio.to_thread(gate.reached.wait, PATIENCE_S)


async def error_of(work: Awaitable[Any]) -> Any:
    (error,) = await asyncio.gather(work, return_exceptions=True)
    return error


@pytest.mark.parametrize("codec", [None, JsonCodec()], ids=["binary", "json"])
async def test_a_robots_day_in_this_process(
    app: FastAPI, engine: Any, fields: dict[str, Any], codec: Any
) -> None:
    async with (
        app.router.lifespan_context(app),
        AsyncAnchorClient("http://test", transport=InProcess(app), codec=codec) as client,
    ):
        assert await client.live()
        assert await client.ready()
        assert [card.name for card in await client.models()] == ["lines", "bows"]
        with pytest.raises(UnknownModel, match="'nobody'"):
            await client.plan(**fields, model="nobody")
        anchors = await client.plan(**fields, request_id="r1")

    planned = engine.plan(engine.seen[-1])
    for name in ARRAY_DTYPES:
        np.testing.assert_array_equal(getattr(anchors, name), getattr(planned, name))
    assert anchors.request_id == "r1"


async def test_over_a_socket_it_gets_what_the_blocking_client_gets(
    url: str, fields: dict[str, Any]
) -> None:
    async with AsyncAnchorClient(url, timeout_s=PATIENCE_S) as client:
        assert await client.live()
        assert await client.ready()
        assert [card.name for card in await client.models()] == ["lines", "bows"]
        anchors = await client.plan(**fields)
        with AnchorClient(url, timeout_s=PATIENCE_S) as blocking:
            expected = blocking.plan(**fields)
            np.testing.assert_array_equal(anchors.trajectories, expected.trajectories)
            refused: tuple[tuple[dict[str, Any], type[InvalidRequest | UnknownModel]], ...] = (
                ({"v_max": 9.0}, InvalidRequest),
                ({"model": "nobody"}, UnknownModel),
            )
            for wrong, kind in refused:
                refusal = await error_of(client.plan(**fields, **wrong))
                with pytest.raises(kind) as caught:
                    blocking.plan(**fields, **wrong)
                assert type(refusal) is kind
                assert refusal.to_dict() == caught.value.to_dict()
                assert refusal.http_status == caught.value.http_status


async def test_requests_at_the_same_time_are_all_on_their_way(
    url: str, planning: PlanningService, gate: Any, fields: dict[str, Any]
) -> None:
    """None is answered before the last of them is in the service."""
    async with AsyncAnchorClient(url, timeout_s=PATIENCE_S) as client:
        asked = asyncio.gather(*(client.plan(**fields, request_id=f"r{n}") for n in range(8)))
        while planning.queue.in_flight < 8:
            await asyncio.sleep(0.001)
        gate.opened.set()
        assert [anchors.request_id for anchors in await asked] == [f"r{n}" for n in range(8)]


async def test_who_is_cancelled_hangs_up_and_frees_the_engine(
    url: str, planning: PlanningService, gate: Any, outcomes: Any, fields: dict[str, Any]
) -> None:
    async with AsyncAnchorClient(url, timeout_s=PATIENCE_S) as client:
        asked = asyncio.ensure_future(client.plan(**fields, request_id="taken back"))
        await reach(gate)
        asked.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asked
        # The service has seen its caller leave while the engine is still at work.
        assert await asyncio.to_thread(outcomes.heard.wait, PATIENCE_S)
        gate.opened.set()
        assert (await client.plan(**fields, request_id="next")).request_id == "next"

    assert outcomes.seen[0] == CANCELLED
    assert planning.queue.in_flight == 0


async def test_a_timeout_hangs_up_too(
    url: str, gate: Any, outcomes: Any, fields: dict[str, Any]
) -> None:
    async with AsyncAnchorClient(url, timeout_s=0.2) as client:
        assert isinstance(await error_of(client.plan(**fields)), TimedOut)

    assert await asyncio.to_thread(outcomes.heard.wait, PATIENCE_S)
    gate.opened.set()
    assert outcomes.seen == [CANCELLED]


async def test_leaving_the_block_fails_what_is_on_its_way(
    url: str, gate: Any, fields: dict[str, Any]
) -> None:
    async with AsyncAnchorClient(url, timeout_s=PATIENCE_S) as client:
        asked = asyncio.ensure_future(client.plan(**fields))
        await reach(gate)

    assert isinstance(await error_of(asked), ConnectionFailed)
    gate.opened.set()


async def test_without_a_server_the_connection_fails(fields: dict[str, Any]) -> None:
    address = free_endpoint().removeprefix("tcp/")
    async with AsyncAnchorClient(f"http://{address}") as client:
        assert not await client.live()
        assert isinstance(await error_of(client.plan(**fields)), ConnectionFailed)
