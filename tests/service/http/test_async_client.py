"""The async client against the real application, in this process and over a real socket."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import asynccontextmanager
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi import FastAPI

from anchorflow_client import (
    AnchorBatch,
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
from anchorflow_service.planning import CANCELLED, Call, Observer, PlanningService

Listen = Callable[[FastAPI], str]
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


@asynccontextmanager
async def in_process(app: FastAPI, **options: Any) -> AsyncIterator[AsyncAnchorClient]:
    transport = InProcess(app)
    async with (
        app.router.lifespan_context(app),
        AsyncAnchorClient("http://test", transport=transport, **options) as client,
    ):
        yield client


class Gate:
    """Holds an engine's answers back until it is opened."""

    def __init__(self) -> None:
        self.reached = threading.Semaphore(0)
        self.opened = threading.Event()

    def __call__(self, batch: AnchorBatch) -> AnchorBatch:
        self.reached.release()
        assert self.opened.wait(PATIENCE_S)
        return batch

    async def reach(self) -> None:
        assert await asyncio.to_thread(self.reached.acquire, timeout=PATIENCE_S)


class Outcomes(Observer):
    """What became of every call."""

    def __init__(self) -> None:
        self.seen: list[str] = []
        self.heard = threading.Event()

    def ended(self, call: Call, outcome: str) -> None:  # noqa: ARG002
        self.seen.append(outcome)
        self.heard.set()


@pytest.fixture
def gate(engine: Any) -> Iterator[Gate]:
    """Holds the default model's answers back, until the test ends at the latest."""
    engine.before_answer = gate = Gate()
    yield gate
    gate.opened.set()


@pytest.fixture
def outcomes(planning: PlanningService) -> Outcomes:
    outcomes = Outcomes()
    planning.watch(outcomes)
    return outcomes


def meeting(work: Awaitable[Any]) -> Any:
    """Return the result or the exception of the work."""

    async def meet() -> Any:
        try:
            return await work
        except Exception as error:  # noqa: BLE001 - compared with the blocking client's
            return error

    return asyncio.run(meet())


@pytest.mark.parametrize("codec", [None, JsonCodec()], ids=["binary", "json"])
def test_a_robots_day_in_this_process(
    app: FastAPI, engine: Any, fields: dict[str, Any], codec: Any
) -> None:
    async def day() -> AnchorBatch:
        async with in_process(app, codec=codec) as client:
            assert await client.live()
            assert await client.ready()
            assert [card.name for card in await client.models()] == ["lines", "bows"]
            with pytest.raises(UnknownModel, match="'nobody'"):
                await client.plan(**fields, model="nobody")
            return await client.plan(**fields, request_id="r1")

    anchors = asyncio.run(day())

    planned = engine.plan(engine.seen[-1])
    for name in ARRAY_DTYPES:
        np.testing.assert_array_equal(getattr(anchors, name), getattr(planned, name))
    assert anchors.request_id == "r1"


def test_a_robots_day_over_a_socket(app: FastAPI, listen: Listen, fields: dict[str, Any]) -> None:
    url = listen(app)

    async def day() -> AnchorBatch:
        async with AsyncAnchorClient(url, timeout_s=PATIENCE_S) as client:
            assert await client.live()
            assert await client.ready()
            assert [card.name for card in await client.models()] == ["lines", "bows"]
            return await client.plan(**fields)

    anchors = asyncio.run(day())

    with AnchorClient(url, timeout_s=PATIENCE_S) as client:
        blocking = client.plan(**fields)
    np.testing.assert_array_equal(anchors.trajectories, blocking.trajectories)


@pytest.mark.parametrize(
    ("wrong", "kind"), [({"v_max": 9.0}, InvalidRequest), ({"model": "nobody"}, UnknownModel)]
)
def test_refusals_are_those_of_the_blocking_client(
    app: FastAPI,
    listen: Listen,
    fields: dict[str, Any],
    wrong: dict[str, Any],
    kind: type[InvalidRequest | UnknownModel],
) -> None:
    url = listen(app)
    with AnchorClient(url) as client, pytest.raises(kind) as caught:
        client.plan(**fields, **wrong)

    async def ask() -> AnchorBatch:
        async with AsyncAnchorClient(url) as client:
            return await client.plan(**fields, **wrong)

    refusal = meeting(ask())
    assert type(refusal) is kind
    assert refusal.to_dict() == caught.value.to_dict()
    assert refusal.http_status == caught.value.http_status


def test_requests_at_the_same_time_are_all_on_their_way(
    app: FastAPI, planning: PlanningService, gate: Gate, listen: Listen, fields: dict[str, Any]
) -> None:
    """None is answered before the last of them is in the service."""
    url = listen(app)

    async def ask() -> list[AnchorBatch]:
        async with AsyncAnchorClient(url, timeout_s=PATIENCE_S) as client:
            asked = asyncio.gather(*(client.plan(**fields, request_id=f"r{n}") for n in range(8)))
            while planning.queue.in_flight < 8:
                await asyncio.sleep(0.001)
            gate.opened.set()
            return await asked

    assert [anchors.request_id for anchors in asyncio.run(ask())] == [f"r{n}" for n in range(8)]


def test_who_is_cancelled_hangs_up_and_frees_the_engine(
    app: FastAPI,
    planning: PlanningService,
    gate: Gate,
    outcomes: Outcomes,
    listen: Listen,
    fields: dict[str, Any],
) -> None:
    url = listen(app)

    async def ask() -> AnchorBatch:
        async with AsyncAnchorClient(url, timeout_s=PATIENCE_S) as client:
            asked = asyncio.ensure_future(client.plan(**fields, request_id="taken back"))
            await gate.reach()
            asked.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asked
            # The service has seen its caller leave while the engine is still at work.
            assert await asyncio.to_thread(outcomes.heard.wait, PATIENCE_S)
            gate.opened.set()
            return await client.plan(**fields, request_id="next")

    assert asyncio.run(ask()).request_id == "next"
    assert outcomes.seen[0] == CANCELLED
    assert planning.queue.in_flight == 0


def test_a_timeout_hangs_up_too(
    app: FastAPI, gate: Gate, outcomes: Outcomes, listen: Listen, fields: dict[str, Any]
) -> None:
    url = listen(app)

    async def ask() -> AnchorBatch:
        async with AsyncAnchorClient(url, timeout_s=0.2) as client:
            return await client.plan(**fields)

    error = meeting(ask())

    assert isinstance(error, TimedOut)
    assert outcomes.heard.wait(PATIENCE_S)
    gate.opened.set()
    assert outcomes.seen == [CANCELLED]


def test_leaving_the_block_fails_what_is_on_its_way(
    app: FastAPI, gate: Gate, listen: Listen, fields: dict[str, Any]
) -> None:
    url = listen(app)

    async def ask() -> AnchorBatch:
        async with AsyncAnchorClient(url, timeout_s=PATIENCE_S) as client:
            asked = asyncio.ensure_future(client.plan(**fields))
            await gate.reach()
        return await asked

    error = meeting(ask())
    gate.opened.set()

    assert isinstance(error, ConnectionFailed)


def test_without_a_server_the_connection_fails(fields: dict[str, Any]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]

    async def ask() -> AnchorBatch:
        async with AsyncAnchorClient(f"http://127.0.0.1:{port}") as client:
            assert not await client.live()
            return await client.plan(**fields)

    assert isinstance(meeting(ask()), ConnectionFailed)
