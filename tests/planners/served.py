"""Applications in this process, and clients of one service over every transport."""

from __future__ import annotations

import json
from collections.abc import AsyncIterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
from anyio.from_thread import BlockingPortal, start_blocking_portal
from fastapi import FastAPI

from anchorflow_benchmarks.programs import free_endpoint
from anchorflow_client import AnchorClient, Codec, JsonCodec, OipCodec, Payload
from anchorflow_client.base_client import BaseClient
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_client.zenoh_messages import AnswerAttachment, RequestAttachment, anchors_key
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService, ServiceLimits
from anchorflow_service.repository import BundleFolders, Repository
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

TRANSPORTS = ("json", "binary", "zenoh")
LENGTH = "Inference-Header-Content-Length"


class InProcess:
    """The application without a socket, inside its lifespan; also a client's transport."""

    def __init__(self, app: FastAPI, portal: BlockingPortal) -> None:
        self._app = app
        self._portal = portal

    def request(
        self,
        method: str,
        path: str,
        *,
        headers: Mapping[str, str] | None = None,
        content: bytes | AsyncIterable[bytes] | None = None,
    ) -> httpx.Response:
        """One request of any kind, on the event loop's own thread."""
        return self._portal.call(self._request, method, path, headers, content)

    def post(self, body: Any, path: str = "/anchors") -> httpx.Response:
        """JSON to a path; bytes go as they are."""
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        headers = {"Content-Type": "application/json"}
        return self.request("POST", path, headers=headers, content=content)

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,  # noqa: ARG002 - nothing here can hang but the test itself
    ) -> tuple[int, Mapping[str, str], bytes]:
        """As a transport of `AnchorClient`."""
        answer = self.request(method, path, headers=headers, content=body)
        return answer.status_code, answer.headers, answer.content

    def close(self) -> None:
        """Nothing to let go of."""

    async def _request(self, method: str, path: str, headers: Any, content: Any) -> httpx.Response:
        transport = httpx.ASGITransport(app=self._app)
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return await client.request(method, path, headers=headers, content=content)


@contextmanager
def in_process(app: FastAPI) -> Iterator[InProcess]:
    """Run an application's lifespan and its requests in this process."""
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(app.router.lifespan_context(app)),
    ):
        yield InProcess(app, portal)


def opened(folder: Path) -> Engine:
    """Return the engine of a bundle, on one thread."""
    return Engine(load_bundle(folder), threads=1)


def app_of(folder: Path) -> FastAPI:
    """Return the application of a bundle, whose repository can load it again."""
    engine = opened(folder)
    name = engine.card.name
    planning = PlanningService({name: engine}, default=name, limits=ServiceLimits(threads=2))
    return create_app(
        planning, repository=Repository(planning.engines, BundleFolders([folder]), opened)
    )


@contextmanager
def on_zenoh(planning: PlanningService, **options: Any) -> Iterator[str]:
    """Open a service on a zenoh network of its own; return where it listens."""
    endpoint = free_endpoint()
    with start_blocking_portal() as portal, planning:
        session = open_session(ZenohSettings(listen=(endpoint,)))
        with portal.wrap_async_context_manager(ZenohEndpoint(planning, session, **options)):
            yield endpoint


@contextmanager
def client_over(transport: str, planning: PlanningService) -> Iterator[BaseClient]:
    """Open a service and a client of it: over zenoh, or in this process in JSON or binary."""
    if transport == "zenoh":
        with on_zenoh(planning) as endpoint, ZenohAnchorClient(endpoint, timeout_s=30) as client:
            yield client
        return
    codec = JsonCodec() if transport == "json" else OipCodec()
    with (
        in_process(create_app(planning)) as app,
        AnchorClient("http://test", transport=app, codec=codec) as client,
    ):
        yield client


def sent_over_http(app: InProcess, codec: Codec, sent: Payload) -> Payload:
    """Return the answer of `POST /anchors`; an error has no header."""
    headers = {"Content-Type": codec.content_type}
    if sent.header_length is not None:
        headers[LENGTH] = str(sent.header_length)
    answer = app.request("POST", "/anchors", headers=headers, content=sent.body)
    length = answer.headers.get(LENGTH)
    return Payload(answer.content, None if length is None else int(length))


def sent_over_zenoh(endpoint: str, model: str, sent: Payload) -> Payload:
    """Return the answer of the only replica; an error has no header."""
    assert sent.header_length is not None
    attachment = RequestAttachment(sent.header_length).to_bytes()
    with open_session(ZenohSettings(mode="client", connect=(endpoint,)), wait_s=10) as session:
        key = anchors_key(model)
        (reply,) = session.get(key, payload=sent.body, attachment=attachment, timeout=20.0)
    if reply.err is not None:
        return Payload(reply.err.payload.to_bytes())
    assert reply.ok is not None
    said = AnswerAttachment.from_bytes(reply.ok.attachment.to_bytes())
    return Payload(reply.ok.payload.to_bytes(), said.header_length)
