"""One service, two transports: the same bytes, from the same queue, in one process."""

from __future__ import annotations

import asyncio
import json
import socket
from typing import Any

import httpx
import pytest

from anchorflow_client import AnchorRequest, OipCodec, Payload
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

CODEC = OipCodec()
LENGTH = "Inference-Header-Content-Length"


@pytest.fixture
def endpoint() -> str:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return f"tcp/127.0.0.1:{listener.getsockname()[1]}"


def over_zenoh(endpoint: str, sent: Payload) -> Payload:
    """What replica "a" answers."""
    attachment = json.dumps({"header_length": sent.header_length}).encode()
    with open_session(ZenohSettings(mode="client", connect=(endpoint,))) as session:
        (reply,) = session.get(
            "anchorflow/v1/replica/a/anchors/lines",
            payload=sent.body,
            attachment=attachment,
            timeout=20.0,
        )
    assert reply.ok is not None
    assert reply.ok.attachment is not None
    said = json.loads(reply.ok.attachment.to_bytes())
    return Payload(reply.ok.payload.to_bytes(), said["header_length"])


async def over_http(client: httpx.AsyncClient, sent: Payload) -> Payload:
    headers = {"Content-Type": CODEC.content_type, LENGTH: str(sent.header_length)}
    answer = await client.post("/anchors", content=sent.body, headers=headers)
    assert answer.status_code == 200
    return Payload(answer.content, int(answer.headers[LENGTH]))


def both(planning: PlanningService, endpoint: str, sent: Payload) -> list[Payload]:
    """The answers of one application over HTTP and over zenoh."""
    zenoh = ZenohEndpoint(planning, open_session(ZenohSettings(listen=(endpoint,))), replica="a")
    app = create_app(planning, endpoints=[zenoh])

    async def ask() -> list[Payload]:
        transport = httpx.ASGITransport(app=app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://test") as client,
        ):
            return [
                await over_http(client, sent),
                await asyncio.to_thread(over_zenoh, endpoint, sent),
            ]

    return asyncio.run(ask())


def test_the_answers_are_the_same_bytes(engine: Any, endpoint: str, fields: dict[str, Any]) -> None:
    """All but the time that each took, which stands still here."""
    planning = PlanningService({"lines": engine}, default="lines", clock=lambda: 7.0)
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | {"request_id": "r1"}))

    by_http, by_zenoh = both(planning, endpoint, sent)

    assert by_http == by_zenoh
    assert CODEC.decode_answer(by_http).request_id == "r1"


def test_with_a_running_clock_only_the_times_differ(
    planning: PlanningService, endpoint: str, fields: dict[str, Any]
) -> None:
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | {"request_id": "r1"}))

    headers, tensors = [], []
    for payload in both(planning, endpoint, sent):
        length = payload.header_length or 0
        header = json.loads(payload.body[:length])
        for stage in ("queue", "total"):
            assert header["parameters"].pop(f"timing_ms.{stage}") > 0
        headers.append(header)
        tensors.append(payload.body[length:])

    assert headers[0] == headers[1]
    assert tensors[0] == tensors[1]
