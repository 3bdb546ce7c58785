"""One contract of every client, blocking and async: over sockets in both forms, and over zenoh."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from blocking_twin import Blocking
from fastapi import FastAPI
from served import on_zenoh

from anchorflow_client import (
    AnchorBatch,
    AnchorClient,
    AsyncAnchorClient,
    Cancelled,
    ConnectionFailed,
    InternalError,
    InvalidRequest,
    JsonCodec,
    UnknownModel,
)
from anchorflow_client.zenoh_client import AsyncZenohAnchorClient, ZenohAnchorClient
from anchorflow_service.planning import PlanningService

PATIENCE_S = 20

CLIENTS: dict[str, tuple[Any, dict[str, Any]]] = {
    "http": (AnchorClient, {}),
    "http json": (AnchorClient, {"codec": JsonCodec()}),
    "http json of bytes": (AnchorClient, {"codec": JsonCodec(base64=True)}),
    "async http": (AsyncAnchorClient, {}),
    "async http json": (AsyncAnchorClient, {"codec": JsonCodec()}),
    "zenoh": (ZenohAnchorClient, {}),
    "async zenoh": (AsyncZenohAnchorClient, {}),
}


@pytest.fixture(params=CLIENTS)
def client(
    request: pytest.FixtureRequest,
    app: FastAPI,
    planning: PlanningService,
    listen: Callable[[FastAPI], str],
) -> Iterator[Any]:
    """A client of `planning`; an async one has a blocking interface."""
    kind, options = CLIENTS[request.param]
    with ExitStack() as stack:
        over_zenoh = "zenoh" in request.param
        address = stack.enter_context(on_zenoh(planning)) if over_zenoh else listen(app)
        client = kind(address, timeout_s=PATIENCE_S, **options)
        if "async" in request.param:
            loop = asyncio.new_event_loop()
            stack.callback(loop.close)
            client = Blocking(client, loop)
        yield stack.enter_context(client)


def test_answers_cards_and_refusals_are_the_services(
    client: Any, engine: Any, fields: dict[str, Any]
) -> None:
    assert client.live()
    assert client.ready()
    cards = client.models()
    assert [card.name for card in cards] == ["lines", "bows"]
    assert cards[0] == engine.card

    fields["x_curr"] = np.array(fields["x_curr"]) + np.pi / 70  # digits that no form may round
    anchors = client.plan(**fields, request_id="r1")
    planned = engine.plan(engine.seen[0])
    assert anchors.arrays.keys() == planned.arrays.keys()
    for name, array in anchors.arrays.items():
        np.testing.assert_array_equal(array, planned.arrays[name])
    assert (anchors.dt, anchors.seed, anchors.model) == (planned.dt, 1, engine.card.id)
    assert set(anchors.timing_ms) == {"queue", "encode", "sample", "refine", "total"}
    assert 0 <= anchors.timing_ms["queue"] <= anchors.timing_ms["total"] != 6.0
    assert anchors.request_id == "r1"
    assert len(client.plan(**fields).request_id or "") == 32

    assert client.plan(**fields, model="bows").model.name == "bows"
    with pytest.raises(InvalidRequest, match=r"robot_radius: .*bows"):
        client.plan(**fields, model="bows", robot_radius=0.4)
    with pytest.raises(UnknownModel, match=r"is served \(bows, lines\), got 'nobody'") as unknown:
        client.plan(**fields, model="nobody")
    assert (unknown.value.field, unknown.value.http_status) == ("model", 404)
    with pytest.raises(InvalidRequest, match="expected 2 m/s, which lines") as caught:
        client.plan(**fields, v_max=9.0)
    assert (caught.value.field, caught.value.http_status) == ("v_max", 422)


def test_a_failure_is_internal_without_its_details(
    client: Any, engine: Any, fields: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    def explode(_: AnchorBatch) -> AnchorBatch:
        raise ZeroDivisionError("secret detail")

    engine.before_answer = explode

    with pytest.raises(InternalError, match="the log tells of request r7") as caught:
        client.plan(**fields, request_id="r7")
    assert "secret" not in str(caught.value)
    assert "request r7 failed" in caplog.text
    assert "secret detail" in caplog.text


@pytest.fixture(params=["http", "zenoh"])
def connect(
    request: pytest.FixtureRequest,
    app: FastAPI,
    planning: PlanningService,
    listen: Callable[[FastAPI], str],
) -> Iterator[Callable[[], Any]]:
    """Makes async clients of `planning`."""
    if request.param == "http":
        url = listen(app)
        yield lambda: AsyncAnchorClient(url, timeout_s=PATIENCE_S)
    else:
        with on_zenoh(planning) as endpoint:
            yield lambda: AsyncZenohAnchorClient(endpoint, timeout_s=PATIENCE_S)


async def reach(gate: Any) -> None:
    assert await asyncio.to_thread(gate.reached.wait, PATIENCE_S)


async def error_of(work: Awaitable[Any]) -> Any:
    (error,) = await asyncio.gather(work, return_exceptions=True)
    return error


@pytest.mark.anyio
async def test_concurrent_requests_are_all_sent(
    connect: Callable[[], Any], planning: PlanningService, gate: Any, fields: dict[str, Any]
) -> None:
    """None is answered before the last of them is in the service."""
    async with connect() as client:
        asked = asyncio.gather(*(client.plan(**fields, request_id=f"r{n}") for n in range(4)))
        while planning.queue.in_flight < 4:
            await asyncio.sleep(0.001)
        gate.opened.set()
        assert [anchors.request_id for anchors in await asked] == [f"r{n}" for n in range(4)]


@pytest.mark.anyio
async def test_leaving_the_block_fails_pending_requests(
    connect: Callable[[], Any], gate: Any, fields: dict[str, Any]
) -> None:
    async with connect() as client:
        asked = asyncio.ensure_future(client.plan(**fields))
        await reach(gate)

    is_http = isinstance(client, AsyncAnchorClient)
    assert isinstance(await error_of(asked), ConnectionFailed if is_http else Cancelled)
    gate.opened.set()
