"""One service, two transports: the same bytes, from the same queue, in one process."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from anyio.from_thread import BlockingPortal, start_blocking_portal
from fastapi import FastAPI

from anchorflow_client import AnchorRequest, OipCodec, Payload, UnknownModel
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService, ServiceLimits
from anchorflow_service.repository import BundleFolders, Repository
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

CODEC = OipCodec()
LENGTH = "Inference-Header-Content-Length"


@pytest.fixture
def endpoint() -> str:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return f"tcp/127.0.0.1:{listener.getsockname()[1]}"


def over_zenoh(endpoint: str, sent: Payload) -> Payload:
    """What replica "a" answers; an error has no header."""
    attachment = json.dumps({"header_length": sent.header_length}).encode()
    with open_session(ZenohSettings(mode="client", connect=(endpoint,))) as session:
        (reply,) = session.get(
            "anchorflow/v1/replica/a/anchors/lines",
            payload=sent.body,
            attachment=attachment,
            timeout=20.0,
        )
    if reply.err is not None:
        return Payload(reply.err.payload.to_bytes(), None)
    assert reply.ok is not None
    assert reply.ok.attachment is not None
    said = json.loads(reply.ok.attachment.to_bytes())
    return Payload(reply.ok.payload.to_bytes(), said["header_length"])


async def over_http(client: httpx.AsyncClient, sent: Payload) -> Payload:
    """The same; an error has no header either."""
    headers = {"Content-Type": CODEC.content_type, LENGTH: str(sent.header_length)}
    answer = await client.post("/anchors", content=sent.body, headers=headers)
    length = answer.headers.get(LENGTH)
    return Payload(answer.content, None if length is None else int(length))


def in_process(app: FastAPI) -> httpx.AsyncClient:
    return httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://test")


def both(planning: PlanningService, endpoint: str, sent: Payload) -> list[Payload]:
    """The answers of one application over HTTP and over zenoh."""
    zenoh = ZenohEndpoint(planning, open_session(ZenohSettings(listen=(endpoint,))), replica="a")
    app = create_app(planning, endpoints=[zenoh])

    async def ask() -> list[Payload]:
        async with app.router.lifespan_context(app), in_process(app) as client:
            return [
                await over_http(client, sent),
                await asyncio.to_thread(over_zenoh, endpoint, sent),
            ]

    return asyncio.run(ask())


def test_own_durations_are_the_same_on_both(
    free_engine: Any, endpoint: str, fields: dict[str, Any]
) -> None:
    planning = PlanningService({"lines": free_engine}, default="lines", clock=lambda: 7.0)
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | {"request_id": "r1"}))

    by_http, by_zenoh = both(planning, endpoint, sent)

    assert by_http == by_zenoh
    durations = CODEC.decode_answer(by_zenoh).durations
    assert durations == pytest.approx([1.0, 1.1, 1.2, 1.3])


def test_the_answers_are_the_same_bytes(engine: Any, endpoint: str, fields: dict[str, Any]) -> None:
    """All but the time that each took, which stands still here."""
    planning = PlanningService({"lines": engine}, default="lines", clock=lambda: 7.0)
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | {"request_id": "r1"}))

    by_http, by_zenoh = both(planning, endpoint, sent)

    assert by_http == by_zenoh
    assert by_http.header_length
    assert CODEC.decode_answer(by_http).request_id == "r1"


@pytest.mark.parametrize(
    ("wrong", "field"),
    [({"v_max": 9.0}, "v_max"), ({"x_curr": [0.0] * 9, "x_goal": [0.0] * 6}, "x_curr")],
)
def test_the_refusals_are_the_same_bytes(
    planning: PlanningService,
    endpoint: str,
    fields: dict[str, Any],
    wrong: dict[str, Any],
    field: str,
) -> None:
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | wrong))

    by_http, by_zenoh = both(planning, endpoint, sent)

    assert by_http == by_zenoh
    error = json.loads(by_http.body)["error"]
    assert (error["code"], error["field"]) == ("invalid_request", field)


def test_what_is_loaded_over_http_is_served_over_zenoh(
    tiny_bundle: Path,
    edit_manifest: Callable[..., None],
    endpoint: str,
    small_request: Callable[..., AnchorRequest],
) -> None:
    """And what is unloaded there is served no longer, nor by the client's older knowledge."""

    def opened(folder: Path) -> Engine:
        return Engine(load_bundle(folder), threads=1)

    engines = {"tiny": opened(tiny_bundle)}
    planning = PlanningService(engines, default="tiny", limits=ServiceLimits(threads=1))
    repository = Repository(planning.engines, BundleFolders([tiny_bundle]), opened)
    session = open_session(ZenohSettings(listen=(endpoint,)))
    app = create_app(planning, endpoints=[ZenohEndpoint(planning, session)], repository=repository)
    # Rename the model of the bundle in the folder.
    edit_manifest("name", to="newer")

    def ask(zenoh: ZenohAnchorClient, name: str) -> str:
        return zenoh.plan_request(small_request(model=name)).model.name

    def change(portal: BlockingPortal, http: httpx.AsyncClient, what: str) -> None:
        assert portal.call(http.post, f"/v2/repository/models/{what}").status_code == 200

    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(app.router.lifespan_context(app)),
        portal.wrap_async_context_manager(in_process(app)) as http,
        ZenohAnchorClient(endpoint, timeout_s=20) as zenoh,
    ):
        assert ask(zenoh, "tiny") == "tiny"
        with pytest.raises(UnknownModel):
            ask(zenoh, "newer")
        change(portal, http, "newer/load")
        assert [ask(zenoh, "newer"), ask(zenoh, "tiny")] == ["newer", "tiny"]
        change(portal, http, "tiny/unload")
        assert portal.call(http.get, "/v2/models/tiny/ready").status_code == 404
        with pytest.raises(UnknownModel, match=r"\(newer\), got 'tiny'"):
            ask(zenoh, "tiny")
        assert ask(zenoh, "newer") == "newer"


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
